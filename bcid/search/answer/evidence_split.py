"""Why one hypothesis is more probable than another: differences of log evidence, split into what they are made of.

At its fit a hypothesis has the logarithm of evidence and prior

    log Z p = - chi^2 / 2 - log det(C) / 2 + Occam + discrepancy + log p

with chi-square and covariance C of its residual, Occam factors of its parameters (MacKay, Information Theory, 2003, section 28.1),
and what an unmodelled discrepancy adds where it has one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bcid.inference.hypotheses import Hypothesis, HypothesisOdds
from bcid.results.diagnosis_record import EvidenceRow, HypothesisRow
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis


@dataclass(frozen=True)
class EvidenceSplit:
    """A hypothesis that was compared with all steps; differences from another one, in the logarithm.

    Attributes:
        hypothesis: it.
        probability: of it.
        misfit: minus half of chi-square.
        volume: minus half of the logarithm of the determinant of the covariance.
        occam: of its parameters.
        discrepancy: of an unmodelled discrepancy.
        prior: of the hypothesis.
    """

    hypothesis: Hypothesis
    probability: float
    misfit: float
    volume: float
    occam: float
    discrepancy: float
    prior: float

    @classmethod
    def of(cls, rival: FittedHypothesis, unknown: bool, odds: HypothesisOdds) -> EvidenceSplit:
        """Of a hypothesis, not yet against another."""
        h = Hypothesis(rival.anchors, rival.hypothesis.effect, unknown)
        state, (log, prior) = rival.judged, rival.weights[h]
        misfit, volume = -0.5 * state.chi2, -state.errors.log_volume
        occam = rival.evidence.plain - misfit - volume
        probability = odds.probabilities.get(h, 0.0)
        return cls(h, probability, misfit, volume, occam, log - rival.evidence.plain, prior)

    @property
    def total(self) -> float:
        """Logarithm of evidence and prior."""
        return self.misfit + self.volume + self.occam + self.discrepancy + self.prior

    def minus(self, other: EvidenceSplit) -> EvidenceSplit:
        """Differences from another one."""
        parts = {name: getattr(self, name) - getattr(other, name) for name in PARTS}
        return EvidenceSplit(self.hypothesis, self.probability, **parts)

    def row(self, order: Sequence[str]) -> EvidenceRow:
        """As results hold it."""
        parts = {name: getattr(self, name) for name in PARTS}
        return EvidenceRow(**vars(hypothesis_row(self.hypothesis, self.probability, order)), **parts)


def hypothesis_row(h: Hypothesis, probability: float, order: Sequence[str]) -> HypothesisRow:
    """A hypothesis as results hold it; `order` has the patches of the scene."""
    anchored = tuple(name for name in order if name in h.anchors)
    return HypothesisRow(anchored=anchored, effects=h.names, unknown=h.unknown, probability=probability)


PARTS = ("misfit", "volume", "occam", "discrepancy", "prior")


def evidence_splits(
    rivals: Sequence[FittedHypothesis], odds: HypothesisOdds, first: Hypothesis, most: int = 4
) -> list[EvidenceSplit]:
    """The likeliest hypotheses that were compared with all steps, as differences from one of them, which comes first.

    Without any where that one was not compared.
    """
    both = [EvidenceSplit.of(rival, unknown, odds) for rival in rivals for unknown in (False, True)]
    # One that is the same as another has no probability of its own.
    found = [one for one in both if one.hypothesis in odds.probabilities]
    base = next((one for one in found if one.hypothesis == first), None)
    if base is None:
        return []
    others = sorted((one for one in found if one is not base), key=lambda one: (-one.total, one.hypothesis.order))
    return [one.minus(base) for one in (base, *others[: most - 1])]
