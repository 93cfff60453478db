"""What explaining found: the verdict, what is believed, and the ladder of models."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from bcid.inference.data import Noise
from bcid.inference.hypotheses import HypothesisOdds
from bcid.inference.thresholds import THRESHOLDS
from bcid.results.diagnosis_record import ChangePointRow
from bcid.search.answer.adequacy import Adequacy
from bcid.search.answer.evidence_split import EvidenceSplit, evidence_splits
from bcid.search.answer.identification import Identification
from bcid.search.fitting.fit import Fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.ranking import Ranking
from bcid.search.fitting.state import State


@dataclass(frozen=True)
class ModelStep:
    """One model of the ladder.

    Attributes:
        fitted: the model, fitted and compared.
        adequacy: the verdict on it.
        held_out: RMS residual when each action is predicted from the others, m, or None.
        ranking: what it lacks, if it was asked.
        rivals: refitted candidates for what it lacks, best first.
    """

    fitted: Fit
    adequacy: Adequacy
    held_out: float | None
    ranking: Ranking | None = None
    rivals: tuple[FittedHypothesis, ...] = ()

    @property
    def state(self) -> State:
        """The model compared with the data."""
        return self.fitted.state

    @property
    def name(self) -> str:
        """Of the model, with the constants of the law that were fitted: "neo_hooke + gravity (young fitted)"."""
        fitted = [number for number in self.state.free if number in self.state.model.values]
        return self.state.model.name + (f" ({' '.join(fitted)} fitted)" if fitted else "")


@dataclass(frozen=True)
class Explanation:
    """What the loop found.

    Attributes:
        verdict: name of the effect adopted, several joined by "+"; "none" if the plain model is adequate, "unknown" if nothing in
            the catalogue explains the data, or nearly.
        odds: what is believed of all hypotheses.
        rungs: the ladder of models: the plain one with the set that is likeliest alone, with that of the last model where it is
            another, and with the effects that were adopted.
        identification: anchors with the last model on the working level.
        rivals: the hypotheses that were compared with all steps, best first.
        noise: what the residual says of the noise, where that is not what is stated, or nothing is.
        trajectories: forward trajectories on the coarse, working and fine levels.
        seconds: time spent.
        neglected: probability of the hypotheses that were not fitted to all steps.
        refuted: whether the reported model has no effect that was added, and the data refute it.
    """

    verdict: str
    odds: HypothesisOdds
    rungs: tuple[ModelStep, ...]
    identification: Identification
    rivals: tuple[FittedHypothesis, ...]
    noise: Noise | None
    trajectories: dict[str, float]
    seconds: float
    neglected: float = 0.0
    refuted: bool = False

    @property
    def probability(self) -> float:
        """Of the verdict: of what it names that it acts, and perhaps more besides that these data do not show.

        Where the data refute the model without effects, "unknown" is all that names no effect.
        """
        return probability_of(self.odds, self.verdict, self.refuted)

    @property
    def slack(self) -> list[FittedHypothesis]:
        """Hypotheses with a patch whose springs may have no stiffness: they count as the set without it."""
        return [r for r in self.rivals if r.hypothesis not in self.odds.probabilities and math.isfinite(r.log)]

    @property
    def splits(self) -> list[EvidenceSplit]:
        """Why the reported hypothesis is more probable than others that were compared with all steps; it comes first."""
        best = next((r for r in self.rivals if r.fitted.state is self.last.state), None)
        if best is None:
            return []
        first = max(best.logs, key=lambda h: self.odds.probabilities.get(h, 0.0))
        return evidence_splits(self.rivals, self.odds, first)

    @property
    def change_point(self) -> ChangePointRow | None:
        """By when what is unknown has begun; None where it more likely goes on with the motion, or is there all the time."""
        best = next((r for r in self.rivals if r.fitted.state is self.last.state), None)
        if self.verdict != "unknown" or best is None or best.evidence.begins is None or best.evidence.sudden < 0.5:
            return None
        data, found = self.last.state.predictor.measurement.data, best.evidence.begins
        action, step = str(data["action"].values[found.by]), int(data["step"].values[found.by])
        return ChangePointRow(action=action, step=step, probability=best.evidence.sudden)

    @property
    def held_by(self) -> float:
        """Probability of the anchors of the last model."""
        return self.odds.held_by(self.last.state.anchors)

    @property
    def open(self) -> bool:
        """Whether verdict or anchors are not certain."""
        return min(self.probability, self.held_by) < THRESHOLDS.credible

    @property
    def ambiguous(self) -> tuple[str, ...]:
        """Other verdicts that have a part in the belief, where none has nearly all of it."""
        if self.probability >= THRESHOLDS.credible:
            return ()
        return tuple(
            name for name, p in self.odds.verdicts.items() if name != self.verdict and p > 1 - THRESHOLDS.credible
        )

    @property
    def last(self) -> ModelStep:
        """The model the loop ended with."""
        return self.rungs[-1]


def verdict_of(effects: Sequence[str], unknown: bool, nearly: bool, adequate: bool) -> str:
    """The verdict of an explanation.

    Args:
        effects: names of the effects of the reported model.
        unknown: whether an unmodelled discrepancy is the most probable explanation.
        nearly: whether these effects explain nearly all of what the model without them misses.
        adequate: whether the data do not refute the reported model.
    """
    if (unknown and not nearly) or not (effects or adequate):
        return "unknown"
    return "+".join(effects) or "none"


def probability_of(odds: HypothesisOdds, verdict: str, refuted: bool) -> float:
    """Of a verdict, see `Explanation.probability`."""
    verdicts = odds.verdicts
    if refuted:
        return min(1.0, verdicts["unknown"] + verdicts["none"])
    return verdicts[verdict] if verdict in ("none", "unknown") else odds.acting(verdict)


def explained(before: Fit, after: Fit) -> float:
    """Which part of a model's chi-square beyond that of its errors another one explains; nothing where there is no such part."""
    excess = before.state.chi2 - len(before.state.predictor.data)
    return (before.state.chi2 - after.state.chi2) / excess if excess > 0 else 0.0


def explains(before: Fit, after: Fit) -> bool:
    """Whether what was added to a model may be named although something is missing besides: it explains nearly all."""
    return explained(before, after) > THRESHOLDS.explained
