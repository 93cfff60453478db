"""Screening: which sets have lost, judged as they are followed, frame by frame.

What a set misses more than the best one is held against a variance in which the error of the level's mesh counts as often as a
trajectory has frames. That takes no sensitivities, and is careful: it keeps sets that the posterior then refuses. Section 4.1 of
the paper.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bcid.inference.mesh_error import gain
from bcid.inference.misfit import Misfit
from bcid.inference.outcome import Candidate, Evaluated, Outcome
from bcid.inference.priors import PRIORS


def screened(evaluated: Evaluated, best: Candidate, errors: Mapping[int, float]) -> dict[Candidate, float]:
    """Logarithms of the odds of everything that was evaluated against the `best` set, the likeliest first.

    Each set is compared on the finest level on which it was evaluated (see `log_odds`). One whose evaluation stopped early has an
    upper bound.

    Args:
        evaluated: holds the outcomes.
        best: that fits best; it must be known on every level used.
        errors: of the model, m, on each of the levels used (see `level_errors`).
    """
    logs = {
        c: log_odds(o, evaluated.outcomes[o.level, best], evaluated.misfit, errors[o.level])
        for c, o in finest(evaluated, max(errors)).items()
    }
    return dict(sorted(logs.items(), key=lambda item: (-item[1], item[0] != best, len(item[0]), sorted(item[0]))))


def finest(evaluated: Evaluated, last: int) -> dict[Candidate, Outcome]:
    """Each visited set with its outcome on the finest level, up to the `last`, on which it could be solved.

    A set that failed there keeps what a coarser level says of it; one that failed everywhere is failed.
    """
    found: dict[Candidate, Outcome] = {}
    for (level, candidate), outcome in sorted(
        evaluated.outcomes.items(), key=lambda item: (item[0][0], sorted(item[0][1]))
    ):
        if level <= last and not (candidate in found and outcome.failed):
            found[candidate] = outcome
    return found


def spread(best: Outcome, misfit: Misfit, error: float) -> float:
    """Variance by which differences of chi-square from the `best` set on its level are judged.

    The residuals hold white noise and the error of the level's model (RMS `error`, m), which persists along a
    trajectory where noise does not. A difference between two sets persists too, so in its direction the error weighs as
    often as a trajectory has frames: the variance is noise^2 + error^2 * frames per trajectory, in units of the noise.
    When the noise is not stated, the best set's residuals stand for it.
    """
    if misfit.noise is None:
        return best.rms**2 + error**2 * misfit.values / misfit.curves
    return 1.0 + (error / misfit.noise) ** 2 * misfit.values / misfit.curves


def log_odds(outcome: Outcome, best: Outcome, misfit: Misfit, error: float) -> float:
    """Logarithm of the odds of a set against the `best` one, both on the same level (see `spread`).

    They are compared on the frames that both could be followed to. That a set cannot be followed further speaks against it by how
    seldom that happens with the true one (`Priors.failures`), however many frames are missing.
    """
    if best.failed:
        # How wrong such a level is, is not known.
        return 0.0
    difference, variance = outcome.beyond(best), spread(best, misfit, error)
    if variance <= 0.0:
        return 0.0 if difference <= 0.0 else -math.inf
    return -difference / (2 * variance) + (math.log(PRIORS.failures) if outcome.failed else 0.0)


def beyond_noise(outcome: Outcome, misfit: Misfit) -> float:
    """What a set's RMS residual has beyond the noise, m: the least that the error of its level's model is taken for."""
    return math.sqrt(max(outcome.rms**2 - (misfit.noise or math.inf) ** 2, 0.0))


def rejection_bound(best: Outcome, misfit: Misfit, odds: float, error: float = 0.0) -> float:
    """Chi-square beyond which a rival is `odds` times less likely than the `best` set on its level: there it may stop.

    `error` (m) is the error of the level's model; at least what the best set's residual has beyond the noise is taken.
    """
    if best.failed:
        return math.inf
    return best.chi2 + 2 * spread(best, misfit, max(error, beyond_noise(best, misfit))) * math.log(odds)


def level_errors(evaluated: Evaluated, best: Candidate, levels: Sequence[int]) -> dict[int, float]:
    """RMS error of the model on each of the levels, m; collective.

    On a coarser level it is how far its prediction of the best set is from the finest level's; on the finest, what
    second-order convergence leaves of the last such difference (Richardson): a third when elements are halved. An error of the
    measured frame is added to it. Nowhere is it less than what the best set's residual has beyond the noise.
    """
    last = levels[-1]
    # Where the model fails for the best set it tells nothing, and `log_odds` does not ask.
    solved = [level for level in levels if not evaluated.outcomes[level, best].failed]
    predicted = {level: evaluated.positions(level, best) for level in solved}
    errors = dict.fromkeys(levels, 0.0)
    errors |= {level: evaluated.misfit.distance(predicted[level], predicted[last]) for level in solved[:-1]}
    if len(solved) > 1:
        errors[last] = errors[solved[-2]] / gain(evaluated.refinement(solved[-2], last))
    for level in solved:
        # The error of the measured frame persists as that of the model does.
        errors[level] = math.hypot(errors[level], evaluated.misfit.common)
        errors[level] = max(errors[level], beyond_noise(evaluated.outcomes[level, best], evaluated.misfit))
    return errors
