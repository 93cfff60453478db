"""`exploration.json`: pulls that were chosen, and what each showed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bcid.results.common_rows import ParameterRow, StiffnessRecord, set_label
from bcid.results.record import FileRecord, Record, length


@dataclass(frozen=True, kw_only=True)
class ExplorationHypothesis(Record):
    """A hypothesis.

    Attributes:
        anchored: names of the anchored patches.
        effect: "" for none.
    """

    anchored: tuple[str, ...]
    effect: str

    @property
    def label(self) -> str:
        """As in tables: "{3 4} + gravity"."""
        return set_label(self.anchored) + (f" + {self.effect}" if self.effect else "")


@dataclass(frozen=True, kw_only=True)
class PosteriorHypothesis(ExplorationHypothesis):
    """The same with its posterior probability.

    Attributes:
        probability: posterior probability.
    """

    probability: float


@dataclass(frozen=True, kw_only=True)
class PullOption(Record):
    """A pull that could be chosen.

    Attributes:
        pull: its name.
        expected_bits, expected_stderr: expected information and its standard error, or None.
        cost: in the unit of the budget.
        linear: whether it was predicted to first order only.
        forbidden: why it is not allowed; "" where it is.
    """

    pull: str
    expected_bits: float | None
    expected_stderr: float | None
    cost: float
    linear: bool
    forbidden: str


@dataclass(frozen=True, kw_only=True)
class ExcludedPull(Record):
    """A pull that is not allowed.

    Attributes:
        pull: its name.
        reason: why it is not allowed.
    """

    pull: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class ExplorationStep(Record):
    """A pull, and the posterior after it.

    Attributes:
        number: from 1.
        pull: in words.
        grasp, direction, amplitude: the pull.
        expected_bits, expected_stderr: expected information before it, or None.
        gained_bits: by how much it lowered the entropy.
        effect_bits: by how much it lowered the entropy of the effects; None where none was considered.
        entropy: after it, bits.
        posterior: the likeliest hypotheses.
        patches, effects: probability of each patch being anchored, and of each effect.
        normalised_rms: RMS residual of the likeliest hypothesis in units of its errors, or None.
        discrepancy_probability: posterior probability of an unmodelled discrepancy.
        outbound: the pull that the body was in before it, or None.
        options: pulls that could be chosen.
        spent: of the budget.
        predicted: how many hypotheses were predicted.
        seconds: time that it took.
    """

    number: int
    pull: str = ""
    grasp: str
    direction: str
    amplitude: float = length()
    expected_bits: float | None
    expected_stderr: float | None
    gained_bits: float
    effect_bits: float | None = None
    entropy: float
    posterior: tuple[PosteriorHypothesis, ...]
    patches: dict[str, float]
    effects: dict[str, float]
    normalised_rms: float | None
    discrepancy_probability: float
    outbound: str | None
    options: tuple[PullOption, ...]
    spent: float
    predicted: int
    seconds: float


@dataclass(frozen=True, kw_only=True)
class ExplorationRecord(FileRecord):
    """The content of `exploration.json`.

    Attributes:
        reason: how it ended: "decided", "inseparable", "unexplained" or "budget".
        anchored, effect, probability: the likeliest hypothesis.
        patches, effects: probability of each patch being anchored, and of each effect.
        parameters: numbers of the likeliest hypothesis' effect, SI.
        entropy: bits.
        rms: RMS residual of the likeliest hypothesis, or None.
        normalised_rms: in units of its errors, or None.
        discrepancy_probability: posterior probability of an unmodelled discrepancy.
        adequate: whether no unmodelled discrepancy is certain.
        stiffness: by known forces, or None.
        remarks: what is unusual about the measurements.
        not_allowed: pulls that the limits exclude.
        not_separated: hypotheses that no allowed pull separates.
        steps: the pulls.
        scene: name of the body.
        telling_pull: number of the pull that showed most about the effects; None where they are not decided.
        body: sizes of the body and its places, in words.
    """

    file: ClassVar[str] = "exploration.json"

    reason: str
    anchored: tuple[str, ...]
    effect: str
    probability: float
    patches: dict[str, float]
    effects: dict[str, float]
    parameters: dict[str, ParameterRow]
    entropy: float
    rms: float | None = length()
    normalised_rms: float | None
    discrepancy_probability: float
    adequate: bool = True
    stiffness: StiffnessRecord | None
    remarks: tuple[str, ...]
    not_allowed: tuple[ExcludedPull, ...]
    not_separated: tuple[ExplorationHypothesis, ...]
    steps: tuple[ExplorationStep, ...]
    scene: str = ""
    telling_pull: int | None = None
    body: tuple[str, ...] = ()

    @property
    def hypothesis(self) -> PosteriorHypothesis:
        """The likeliest one."""
        return PosteriorHypothesis(anchored=self.anchored, effect=self.effect, probability=self.probability)
