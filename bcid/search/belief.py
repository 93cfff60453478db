"""The probabilistic reading of a search (section 4.1 of the paper): how likely each visited anchor set is, and each patch."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
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
    def of(cls, farm: Farm, best: Candidate, errors: Mapping[int, float]) -> Belief:
        """Belief over everything the farm has evaluated, around the `best` set, which must be known on every level used.

        `errors` gives the error of the model, m, on each of the levels used (see `model_errors`).
        """
        logs = {
            c: log_likelihood(o, farm.outcomes[o.level, best], farm.misfit, errors[o.level])
            for c, o in finest(farm, max(errors)).items()
        }
        highest = max(logs.values())
        weights = {c: math.exp(value - highest) for c, value in logs.items()}
        total = sum(weights.values())
        probability = {c: w / total for c, w in weights.items()}
        return cls(probability, {patch: _marginal(probability.items(), patch) for patch in farm.patches})


def _marginal(items: Iterable[tuple[Candidate, float]], patch: str) -> float:
    return min(1.0, math.fsum(p for candidate, p in items if patch in candidate))


def finest(farm: Farm, last: int) -> dict[Candidate, Outcome]:
    """Each visited set with its outcome on the finest level, up to the `last`, on which it could be solved.

    A set that failed there keeps what a coarser level says of it; one that failed everywhere is failed.
    """
    found: dict[Candidate, Outcome] = {}
    for (level, candidate), outcome in sorted(farm.outcomes.items(), key=lambda item: (item[0][0], sorted(item[0][1]))):
        if level <= last and not (candidate in found and outcome.failed):
            found[candidate] = outcome
    return found


def log_likelihood(outcome: Outcome, best: Outcome, misfit: Misfit, error: float) -> float:
    """Logarithm of the likelihood of a set against that of the `best` one, both on the same level.

    The residuals hold white noise and the error of the level's model (RMS `error`, m), which persists along a
    trajectory where noise does not. A difference between two sets persists too, so in its direction the error weighs as
    often as a trajectory has frames: the variance is noise^2 + error^2 * frames per trajectory. When the noise is not
    stated, the best set's residuals stand for it.
    """
    if outcome.failed:
        return -math.inf
    if best.failed:
        return 0.0
    difference, variance = outcome.chi2 - best.chi2, 1.0
    if misfit.noise is None:
        variance = best.rms**2
    else:
        error /= misfit.noise
    total = variance + error**2 * misfit.values / misfit.curves
    if total <= 0.0:
        return 0.0 if difference <= 0.0 else -math.inf
    return -difference / (2 * total)


def model_errors(farm: Farm, best: Candidate, levels: Sequence[int]) -> dict[int, float]:
    """RMS error of the model on each of the levels, m; collective.

    On a coarser level it is how far its prediction of the best set is from the finest level's; on the finest, a third of
    the last such difference, as second-order convergence leaves when elements are halved; nowhere less than what the
    best set's residual has beyond the noise.
    """
    last = levels[-1]
    # Where the model fails for the best set it tells nothing, and `log_likelihood` does not ask.
    solved = [level for level in levels if not farm.outcomes[level, best].failed]
    predicted = {level: farm.positions(level, best) for level in solved}
    errors = dict.fromkeys(levels, 0.0)
    errors |= {level: farm.misfit.distance(predicted[level], predicted[last]) for level in solved[:-1]}
    if len(solved) > 1:
        errors[last] = errors[solved[-2]] / 3
    for level in solved:
        beyond = farm.outcomes[level, best].rms ** 2 - (farm.misfit.noise or math.inf) ** 2
        errors[level] = max(errors[level], math.sqrt(max(beyond, 0.0)))
    return errors
