"""`diagnosis.json` and `discrepancy.json`: is a model adequate, where does it disagree, which effect is missing."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from bcid.results.common_rows import (
    ConstantRow,
    InputUncertaintyRow,
    LeftOutRow,
    ParameterRow,
    StiffnessRecord,
    set_label,
)
from bcid.results.record import FileRecord, Record, length


@dataclass(frozen=True, kw_only=True)
class SelectedEffect(Record):
    """An effect of the last model.

    Attributes:
        effect, place: its name and place ("" for none).
        parameters: its numbers.
    """

    effect: str
    place: str
    parameters: dict[str, ParameterRow]


@dataclass(frozen=True, kw_only=True)
class TimeHistory(Record):
    """An amount of an effect that changes with time.

    Attributes:
        effect, place: whose it is.
        amount, unit: name of the parameter and its unit.
        stepwise: whether it is constant between knots, else linear.
        times: knots, s.
        values: at the knots.
        stderr: standard errors; None where a value is not determined.
        stderr_from_mean: standard errors of the differences from the mean of all; None where it was not fitted.
        p_constant: p-value of a constant amount; None where it was not fitted.
        changes: whether that is small enough to say that it changes; None where it was not fitted.
    """

    effect: str
    place: str
    amount: str
    unit: str
    stepwise: bool
    times: tuple[float, ...]
    values: tuple[float, ...]
    stderr: tuple[float | None, ...]
    stderr_from_mean: tuple[float | None, ...] | None = None
    p_constant: float | None = None
    changes: bool | None = None


# Name of the finding that a model fits up to a frame only.
BREAKING = "from a frame on"


@dataclass(frozen=True)
class Finding(Record):
    """A test of the residual.

    Attributes:
        name: what it tests.
        p_value: probability of such a residual, or a larger one, if only the errors act.
        text: the finding in words.
        decides: whether it counts for adequacy (the others only describe).
    """

    name: str
    p_value: float
    text: str
    decides: bool = False


@dataclass(frozen=True, kw_only=True)
class RankedEffect(Record):
    """A row of the ranking of missing effects.

    Attributes:
        effect, place: what would be added, and where ("" for nowhere in particular).
        anchored: anchors that it was fitted with; None where it was not fitted.
        parameters: its numbers, fitted or as the score test predicts them.
        score: score statistic.
        p_value: of the score, all variants counted.
        expected_rms, fitted_rms, held_out_rms: RMS residual as predicted, after fitting, and leaving one action out.
        power: probability that these data would show a noticeable amount.
        confounded_with: effects that do nearly the same on these data.
        identifiable: whether these data determine it.
        tried: how many variants were scored.
    """

    effect: str
    place: str
    anchored: tuple[str, ...] | None = None
    parameters: dict[str, ParameterRow]
    score: float
    p_value: float
    expected_rms: float = length()
    fitted_rms: float | None = length(default=None)
    held_out_rms: float | None = length(default=None)
    power: float
    confounded_with: tuple[str, ...]
    identifiable: bool
    tried: int


@dataclass(frozen=True, kw_only=True)
class ModelRow(Record):
    """A model of the model sequence.

    Attributes:
        model: its name, as "neo_hooke + gravity".
        anchored: names of the anchored patches.
        rms: RMS residual per coordinate.
        normalised_rms: the same in units of all its errors; None in files of format/1.
        held_out_rms: leave-one-action-out error, or None.
        adequate: whether its errors explain the residual; None where no noise is stated.
        p_value: of adequacy.
    """

    model: str
    anchored: tuple[str, ...]
    rms: float = length()
    normalised_rms: float | None = None
    held_out_rms: float | None = length(default=None)
    adequate: bool | None
    p_value: float


@dataclass(frozen=True, kw_only=True)
class HypothesisRow(Record):
    """A hypothesis.

    Attributes:
        anchored: names of the anchored patches.
        effects: names of its effects.
        unknown: whether an unmodelled discrepancy acts besides.
        probability: posterior probability.
    """

    anchored: tuple[str, ...]
    effects: tuple[str, ...]
    unknown: bool
    probability: float

    @property
    def label(self) -> str:
        """As in tables: "{3 4} + gravity and something unknown"."""
        more = " and something unknown" if self.unknown else ""
        return set_label(self.anchored) + (f" + {'+'.join(self.effects)}" if self.effects else "") + more


@dataclass(frozen=True, kw_only=True)
class EvidenceRow(HypothesisRow):
    """Log evidence of a hypothesis minus that of the reported one, by term.

    Attributes:
        misfit: weighted residual.
        volume: determinant of the covariance.
        occam: parameters.
        discrepancy: unmodelled discrepancy.
        prior: prior probability.
    """

    misfit: float
    volume: float
    occam: float
    discrepancy: float
    prior: float

    @property
    def total(self) -> float:
        """Difference of the log evidence, with the prior."""
        return self.misfit + self.volume + self.occam + self.discrepancy + self.prior


@dataclass(frozen=True, kw_only=True)
class PosteriorRow(Record):
    """Posterior probabilities.

    Attributes:
        effects: of verdicts, with "none" and "unknown".
        patches: of each patch being anchored.
        hypotheses: the likeliest.
    """

    effects: dict[str, float]
    patches: dict[str, float]
    hypotheses: tuple[HypothesisRow, ...]


@dataclass(frozen=True, kw_only=True)
class ChangePointRow(Record):
    """When an unmodelled discrepancy begins.

    Attributes:
        action, step: by when it has begun, with 95 %.
        probability: that it begins at some time, if there is one.
    """

    action: str
    step: int
    probability: float


@dataclass(frozen=True, kw_only=True)
class SensitivityRow(Record):
    """The answer with one input of the scene two standard deviations off.

    Attributes:
        input, label: its name, and what it is called in tables.
        stddev: its standard deviation, SI.
        offset: in standard deviations.
        shift: the offset with its unit, as text.
        verdict, verdict_probability: the answer.
        anchored, anchors_probability: the anchors.
        depends: whether the answer depends on this input.
    """

    input: str
    label: str
    stddev: float
    offset: float
    shift: str
    verdict: str
    verdict_probability: float
    anchored: tuple[str, ...]
    anchors_probability: float
    depends: bool


@dataclass(frozen=True, kw_only=True)
class NextStep(Record):
    """Something to do next.

    Attributes:
        kind: "number", "pull", "force", "markers" or "repeat".
        text: in words.
        expected_bits: expected information on anchors and effects.
        positions: of markers to add.
    """

    kind: str
    text: str
    expected_bits: float
    positions: tuple[tuple[float, ...], ...] = length(default=())


@dataclass(frozen=True, kw_only=True)
class SeparatingPull(Record):
    """A pull that separates the two likeliest explanations.

    Attributes:
        grasp, direction, distance: of the gripper.
        sigmas: distance of the two predictions in standard deviations of the noise, over all markers and steps.
    """

    grasp: str
    direction: str
    distance: float = length()
    sigmas: float


@dataclass(frozen=True, kw_only=True)
class DiagnosisRecord(FileRecord):
    """The content of `diagnosis.json`.

    Attributes:
        verdict: names of the missing effects joined by "+", "none", or "unknown".
        verdict_probability: its posterior probability; None where anchors and effects were not searched.
        anchored: anchored patches of the last model.
        anchors_probability: posterior probability of these anchors, or None.
        anchors_certain: whether that is at least 95 %, or None.
        model: the last model.
        adequate: whether its errors explain the residual; None where no noise is stated.
        p_value, false_alarm_rate: of adequacy, and below which it is rejected.
        rms, held_out_rms: RMS residual per coordinate, and leave-one-action-out error.
        far_above_noise: whether the residual is so much larger than the noise that it is said before all else.
        noise_rms, noise_stated: noise per coordinate, and whether it is stated or estimated.
        noise_like_rms: the part of the residual that is like noise.
        noise_warning: why the stated noise is not used; "" where it is.
        discretisation_rms: of what may be left of the discretisation error, or None.
        input_uncertainties: inputs of the scene that may be slightly wrong.
        curvature: by action, the RMS of second-order displacements that the covariance allows for.
        stiffness: by known forces, or None.
        law: fitted constants of the constitutive model.
        selected_effects: effects of the last model that were added.
        time_histories: amounts that change with time.
        contributions: RMS displacement of each effect of the last model.
        model_sequence: the models, the first one first.
        tests: tests of adequacy of the last model.
        residual_by: RMS residual in units of noise, by "action", "step", "fiducial" and "axis".
        ranking: missing effects, the best first.
        variants_tried: how many variants of effects were scored; their p-values count them all.
        not_applicable: effects that cannot act here, with the reason.
        ambiguous_with: other verdicts that these data do not exclude.
        separating_pulls: pulls that separate the two likeliest explanations.
        scene_sensitivity: the answer with inputs of the scene off.
        entropy: of anchors and effects, bits; None where it was not computed.
        least_bits: less information is not worth a step, bits.
        next_steps: what to do next, the most informative first.
        posterior: posterior probabilities, or None.
        unfitted_probability: posterior probability of hypotheses that were not fitted to all steps.
        without_stiffness: hypotheses with a patch whose springs may have no stiffness; they count as the set without it.
        evidence_split: why the reported hypothesis is more probable than others.
        change_point: when an unmodelled discrepancy begins, or None.
        warnings, skipped: of the fit, and what could not be computed.
        remarks: what is unusual about the measurement.
        left_out: frames that were not compared, or None.
        body: sizes of the body and its places, in words.
    """

    file: ClassVar[str] = "diagnosis.json"

    verdict: str
    verdict_probability: float | None = None
    anchored: tuple[str, ...]
    anchors_probability: float | None = None
    anchors_certain: bool | None = None
    model: str
    adequate: bool | None
    p_value: float
    false_alarm_rate: float
    rms: float = length()
    held_out_rms: float | None = length(default=None)
    far_above_noise: bool = False
    noise_rms: float = length()
    noise_stated: bool
    noise_like_rms: float = length()
    noise_warning: str = ""
    discretisation_rms: float | None = length(default=None)
    input_uncertainties: tuple[InputUncertaintyRow, ...]
    curvature: dict[str, float] = length(default_factory=dict)
    stiffness: StiffnessRecord | None = None
    law: dict[str, ConstantRow] = field(default_factory=dict)
    selected_effects: tuple[SelectedEffect, ...]
    time_histories: tuple[TimeHistory, ...] = ()
    contributions: dict[str, float] = length(default_factory=dict)
    model_sequence: tuple[ModelRow, ...]
    tests: tuple[Finding, ...]
    residual_by: dict[str, dict[str, float]]
    ranking: tuple[RankedEffect, ...] = ()
    variants_tried: int = 0
    not_applicable: dict[str, str] = field(default_factory=dict)
    ambiguous_with: tuple[str, ...] = ()
    separating_pulls: tuple[SeparatingPull, ...] = ()
    scene_sensitivity: tuple[SensitivityRow, ...] = ()
    entropy: float | None = None
    least_bits: float = 0.0
    next_steps: tuple[NextStep, ...] = ()
    posterior: PosteriorRow | None = None
    unfitted_probability: float = 0.0
    without_stiffness: tuple[HypothesisRow, ...] = ()
    evidence_split: tuple[EvidenceRow, ...] = ()
    change_point: ChangePointRow | None = None
    warnings: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    left_out: LeftOutRow | None = None
    body: tuple[str, ...] = ()

    @property
    def first_inadequate(self) -> ModelRow:
        """The model that missing effects are ranked beside."""
        return next((row for row in self.model_sequence if not row.adequate), self.model_sequence[0])


@dataclass(frozen=True, kw_only=True)
class ForceRow(Record):
    """A force on a region.

    Attributes:
        position: middle of the region, three components.
        force: three components, N.
        stderr: standard error of a component, N.
    """

    position: tuple[float, ...] = length()
    force: tuple[float, ...]
    stderr: float


@dataclass(frozen=True, kw_only=True)
class TotalForce(Record):
    """Sums over the body, which may be known where no part is.

    Attributes:
        steady: of the steady force.
        growing: by action, of the force at its end.
    """

    steady: ForceRow
    growing: dict[str, ForceRow]


@dataclass(frozen=True, kw_only=True)
class DiscrepancyRecord(FileRecord):
    """The content of `discrepancy.json`: a smooth force that would explain the residual of an inadequate model.

    Attributes:
        explained_fraction: of the residual beyond the errors, that it explains.
        rms: RMS residual that it leaves.
        steady: force in all frames, by region.
        growing: by action, force that grows with the pull, by region.
        together: sums over the body.
    """

    file: ClassVar[str] = "discrepancy.json"
    former: ClassVar[str] = "where.json"

    explained_fraction: float
    rms: float = length()
    steady: tuple[ForceRow, ...]
    growing: dict[str, tuple[ForceRow, ...]]
    together: TotalForce
