"""Does an answer survive the scene? It is given for each input of the scene, and the noise, at two standard deviations either way.

Equation (1) is conditioned on one input: its column leaves the covariance, and the residual loses two of its standard deviations.
That needs no solve. It is done with the hypotheses that were fitted to all steps; what is below that fidelity is left out.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.forms.mesh.shares import share
from bcid.forms.model import Model, Term
from bcid.forms.scene_errors import Outline
from bcid.inference.discrepancy import conditional
from bcid.inference.evidence import KnownNuisance, LinearParameters
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds
from bcid.inference.nuisance_text import amount
from bcid.inference.priors import PRIORS
from bcid.inference.thresholds import THRESHOLDS
from bcid.results.diagnosis_record import SensitivityRow
from bcid.search.answer.explanation import Explanation, explains, probability_of, verdict_of
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.loosened import slackens
from bcid.search.fitting.parameter_priors import of_state
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
# Offsets of an input, in its standard deviations.
OFFSETS = (-2.0, 2.0)
_AXES = "xyz"
# A direction is along an axis where its component is larger.
_ALONG = 0.9
_WORDS = {
    "poisson": "Poisson's ratio",
    "law.part": "stiffening of the law with strain",
    "law.second": "share of the law's second invariant",
    "stiffness": "stiffness of the law",
    "scale": "length of a pixel",
    "force_gain": "gain of the force sensor",
}


@dataclass(frozen=True)
class SceneInput:
    """An input of the scene that is one number.

    Attributes:
        name: as in the scene's table of uncertainty.
        label: in words.
        stddev: in its own unit (m, deg or 1).
    """

    name: str
    label: str
    stddev: float


@dataclass(frozen=True)
class Answer:
    """Verdict and anchors with their probabilities."""

    verdict: str
    probability: float
    anchors: frozenset[str]
    held_by: float

    @property
    def certain(self) -> bool:
        """Whether both are."""
        return min(self.probability, self.held_by) >= THRESHOLDS.credible

    def like(self, other: Answer) -> bool:
        """Whether verdict and anchors are the same."""
        return (self.verdict, self.anchors) == (other.verdict, other.anchors)


@dataclass(frozen=True)
class AnswerAt:
    """An answer where an input is off.

    Attributes:
        input: which.
        offset: by so many of its standard deviations.
        answer: then.
        depends: whether verdict or anchors are others, or are no longer certain.
    """

    input: SceneInput
    offset: float
    answer: Answer
    depends: bool

    @property
    def shifted(self) -> str:
        """By how much the input is off: "+0.054", "−4 %"."""
        sign = "+" if self.offset > 0 else "−"
        return sign + amount(self.input.name, abs(self.offset) * self.input.stddev)

    def row(self, order: Sequence[str]) -> SensitivityRow:
        """As results hold it; `order` has the patches of the scene."""
        return SensitivityRow(
            input=self.input.name,
            label=self.input.label,
            stddev=self.input.stddev,
            offset=self.offset,
            shift=self.shifted,
            verdict=self.answer.verdict,
            verdict_probability=self.answer.probability,
            anchored=tuple(name for name in order if name in self.answer.anchors),
            anchors_probability=self.answer.held_by,
            depends=self.depends,
        )


@dataclass(frozen=True)
class WeighedHypothesis:
    """A hypothesis that was fitted to all steps, as its evidence sees it.

    Attributes:
        rival: it.
        reported: the hypothesis as which it counts: springs without stiffness hold nothing.
        numbers: its fitted numbers, in units of the errors that it was weighed by.
        inputs: columns of its nuisances, by the input that they are.
    """

    rival: FittedHypothesis
    reported: Hypothesis
    numbers: LinearParameters
    inputs: Mapping[SceneInput, int]

    @classmethod
    def of(cls, rival: FittedHypothesis, reported: Hypothesis, begun: Model) -> WeighedHypothesis | None:
        """Of a hypothesis; None where these data could not show its amounts. Collective."""
        state, own = rival.judged, rival.fitted.state.errors
        moved = [state.errors.whiten(own.unwhiten(column)) for column in rival.fitted.jacobian.T]
        numbers = of_state(state, begun, np.column_stack([*moved, np.zeros((len(state.predictor.data), 0))]))
        return None if numbers is None else cls(rival, reported, numbers, inputs_of(state))

    def logs(
        self, one: SceneInput | None = None, values: Array | None = None, larger: float = 1.0
    ) -> dict[Hypothesis, Array]:
        """Logarithms of evidence and prior, without and with a discrepancy besides, where an input has some values.

        Args:
            one: the input; none by default. Of one that the hypothesis does not have, or fits, nothing changes.
            values: in its standard deviations, shape (values,).
            larger: factor of all errors.
        """
        state, known = self.rival.judged, None
        count = 1 if values is None else len(values)
        if one is not None and values is not None and one in self.inputs:
            known = KnownNuisance(state.errors.of_nuisance(self.inputs[one]), values)
        begins = self.rival.evidence.begins
        found = conditional(state.errors, state.residual, state.forces, self.numbers, begins, known, larger)
        each = zip(self.rival.weights.items(), found, strict=True)
        return {
            replace(self.reported, unknown=h.unknown): np.broadcast_to(logs + prior, (count,))
            for (h, (_, prior)), logs in each
        }


def fitted_hypotheses(found: Explanation) -> list[WeighedHypothesis]:
    """The hypotheses of an explanation that were fitted to all steps; collective."""
    begun = found.rungs[0].state.model
    known = [(r, reported_as(r, found.odds)) for r in found.rivals if math.isfinite(r.log)]
    made = [WeighedHypothesis.of(rival, h, begun) for rival, h in known if h is not None]
    return [one for one in made if one is not None]


def reported_as(rival: FittedHypothesis, odds: HypothesisOdds) -> Hypothesis | None:
    """The hypothesis as which one counts: itself, or where its springs may have no stiffness that without them and the patch."""
    if rival.hypothesis in odds.probabilities:
        return rival.hypothesis
    for term in rival.fitted.state.model.terms:
        if term.place and slackens(term.effect):
            names = "+".join(name for name in rival.names if name != term.effect.name)
            free = Hypothesis(rival.anchors - {term.place}, names)
            if free in odds.probabilities:
                return free
    return None


def inputs_of(state: State) -> dict[SceneInput, int]:
    """Inputs that are one number each, and their columns.

    What differs by marker or action, and the measured frame, which has three turns without names, are not.
    """
    modes, patches = state.errors.nuisances, _middles(state)
    numbers = modes.numbers or (None,) * len(modes.names)
    labels = [_label(name, number, patches) for name, number in zip(modes.names, numbers, strict=True)]
    count = Counter(labels)
    return {
        SceneInput(name, label, modes.sizes[name]): column
        for column, (name, label) in enumerate(zip(modes.names, labels, strict=True))
        if label and count[label] == 1
    }


def _middles(state: State) -> dict[str, Array]:
    """Of the patches that a set holds, and of regions of the body, (3,), m, as the borders of the scene have them."""
    predictor = state.predictor
    mesh, scene = predictor.forward(state.model).mesh, predictor.scene
    found = {f"patch {name}": Outline.of(mesh, scene.patches[name], f"patch {name}") for name in sorted(state.anchors)}
    found |= {
        f"region {name}": Outline.of_volume(mesh, share(mesh, region, name)) for name, region in scene.regions.items()
    }
    return {name: outline.middle for name, outline in found.items() if outline is not None}


def _label(name: str, number: tuple[Term, str] | None, patches: Mapping[str, Array]) -> str:
    """A nuisance of one number in words; "" of one without a name of its own."""
    if number is None:
        return _WORDS.get(name, "")
    term, parameter = number
    if name == "law":
        return _WORDS[f"law.{parameter}"]
    if name.startswith("grip"):
        return f"{'place' if name == 'grip' else 'turn'} of the gripper, {parameter[-1]}"
    direction = np.array([term.values[f"d{axis}"] for axis in _AXES])
    if name == "dimensions":
        return f"extent of the body along {_along(direction)}"
    middle = np.array([term.values[f"c{axis}"] for axis in _AXES])
    patch = next((patch for patch, there in patches.items() if np.allclose(there, middle)), "")
    where = f"grasp {term.place}" if term.place else patch
    way = "place" if term.values["shift"] else "extent"
    return f"{way} of {where} along {_along(direction)}" if where else ""


def _along(direction: Array) -> str:
    """A direction in words: "x", or its components."""
    axis = int(np.argmax(np.abs(direction)))
    if abs(direction[axis]) > _ALONG:
        return _AXES[axis]
    signed = direction * np.sign(direction[axis])
    return f"({' '.join(f'{round(part, 2) + 0.0:.2f}' for part in signed)})"


def scene_sensitivity(found: Explanation, fitted: Sequence[WeighedHypothesis]) -> list[AnswerAt]:
    """The answer at two standard deviations of each input, and of the noise, either way; collective.

    Args:
        found: the explanation.
        fitted: its hypotheses that were fitted to all steps.
    """
    if not fitted:
        return []
    here = answer(found, _odds([one.logs() for one in fitted], 0, found))
    inputs = dict.fromkeys(one for each in fitted for one in each.inputs)
    rows = []
    for one in inputs:
        logs = [each.logs(one, np.array(OFFSETS)) for each in fitted]
        rows += [(one, offset, answer(found, _odds(logs, k, found))) for k, offset in enumerate(OFFSETS)]
    noise = SceneInput("noise", "noise", noise_error(found))
    for offset in OFFSETS:
        logs = [each.logs(larger=math.exp(offset * noise.stddev)) for each in fitted]
        rows.append((noise, offset, answer(found, _odds(logs, 0, found))))
    return [
        AnswerAt(one, offset, then, not then.like(here) or (here.certain and not then.certain))
        for one, offset, then in rows
    ]


def noise_error(found: Explanation) -> float:
    """Relative standard deviation of the noise: that of the estimate, or a convention where it is stated."""
    data = found.last.state.predictor.data
    if found.noise is not None:
        return found.noise.error
    return PRIORS.noise_error if data.stated else 1 / math.sqrt(2 * len(data))


def _odds(logs: Sequence[Mapping[Hypothesis, Array]], at: int, found: Explanation) -> HypothesisOdds:
    """Of hypotheses that count as the same one the sum."""
    each: dict[Hypothesis, float] = {}
    for h, values in (item for some in logs for item in some.items()):
        each[h] = float(np.logaddexp(each.get(h, -math.inf), values[at]))
    return HypothesisOdds.of(each, found.odds.alike)


def answer(found: Explanation, odds: HypothesisOdds) -> Answer:
    """What an explanation would answer with other probabilities of its fitted hypotheses.

    The predictive check is that of the reported model.
    """
    best = odds.best
    rival = next(r for r in found.rivals if r.hypothesis == best.known)
    refuted = found.refuted and not best.names
    nearly = bool(best.names) and explains(found.rungs[0].fitted, rival.fitted)
    verdict = verdict_of(best.names, best.unknown, nearly, not refuted)
    return Answer(verdict, probability_of(odds, verdict, refuted), best.anchors, odds.held_by(best.anchors))
