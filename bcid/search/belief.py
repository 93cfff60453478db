"""The probabilistic reading of a search (section 4.1 of the paper): how likely each visited anchor set is, and each patch."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from bcid.search.farm import Candidate, Farm, Outcome
from bcid.search.misfit import Misfit


@dataclass(frozen=True)
class Belief:
    """Probabilities over the visited anchor sets.

    Each set has the likelihood of its residuals on the finest level on which it was evaluated, relative to the best set
    on that level (see `log_likelihood`), with equal prior probabilities. Failed sets have probability zero.

    Attributes:
        probability: by set; sums to one. A set whose evaluation stopped early has an upper bound here.
        patches: probability that each patch is anchored.
    """

    probability: dict[Candidate, float]
    patches: dict[str, float]

    @classmethod
    def of(cls, farm: Farm, best: Candidate) -> Belief:
        """Belief over everything the farm has evaluated, around the `best` set, which must be known on every level used."""
        logs = {c: log_likelihood(o, farm.outcomes[o.level, best], farm.misfit) for c, o in finest(farm).items()}
        highest = max(logs.values())
        weights = {c: math.exp(value - highest) for c, value in logs.items()}
        total = sum(weights.values())
        probability = {c: w / total for c, w in weights.items()}
        return cls(probability, {patch: _marginal(probability.items(), patch) for patch in farm.patches})


def _marginal(items: Iterable[tuple[Candidate, float]], patch: str) -> float:
    return min(1.0, math.fsum(p for candidate, p in items if patch in candidate))


def finest(farm: Farm, below: int | None = None) -> dict[Candidate, Outcome]:
    """Each visited set with its outcome on the finest level it was evaluated on (of the levels up to `below`, if given)."""
    found: dict[Candidate, Outcome] = {}
    for (level, candidate), outcome in sorted(farm.outcomes.items(), key=lambda item: (item[0][0], sorted(item[0][1]))):
        if below is None or level <= below:
            found[candidate] = outcome
    return found


def log_likelihood(outcome: Outcome, best: Outcome, misfit: Misfit) -> float:
    """Logarithm of the likelihood of a set against that of the `best` one, both on the same level.

    Where even the best set misses the data by more than the noise, the level's model is in error by the rest. The
    variance is then that of the best set's residuals instead of the noise's; and because an error of the model persists
    along a trajectory, where noise does not, only so many values count as independent: all of them for the part of the
    variance that is noise, one per trajectory for the part that is error.
    """
    if outcome.failed:
        return -math.inf
    if best.failed:
        return 0.0
    variance = best.chi2 / misfit.values
    if variance <= 0.0:
        return 0.0 if outcome.chi2 <= 0.0 else -math.inf
    noise_part = min(1.0, 1.0 / variance) if misfit.noise is not None else 1.0
    independent = misfit.values * noise_part + misfit.curves * (1.0 - noise_part)
    inflated = max(1.0, variance) if misfit.noise is not None else variance
    return -(outcome.chi2 - best.chi2) / (2 * inflated) * independent / misfit.values
