"""Courses in time of an effect's amounts: where their knots are, and what they would do, from what constant amounts do."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.base.tails import chi2_tail
from bcid.base.units import UNTOLD
from bcid.forms.course import Course, course_of, in_time
from bcid.forms.model import Term
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Measurement
from bcid.results.diagnosis_record import TimeHistory
from bcid.search.fitting.fit import Fit
from bcid.search.fitting.state import State
from bcid.search.fitting.variants import Variant, amounts

Array = NDArray[np.float64]
# So many knots at most, unless more are asked for; each has at least so many frames.
KNOTS, _FRAMES = 8, 2


def knots(measurement: Measurement, most: int = KNOTS, stepwise: bool = False) -> tuple[float, ...]:
    """Times of the knots of a course over a measurement, s: evenly over the times at which something was seen.

    Of a stepwise course each is midway between two frames, and the first at the first frame.

    The times are those of the measurement's actions: where every action begins at 0 s again, a course is the same in each.

    Args:
        measurement: what was seen.
        most: so many at most; fewer where there are not two frames, at different times, for each.
        stepwise: whether the amounts are to be constant between knots.

    Raises:
        InputError: there are too few frames for two knots.
    """
    seen = np.asarray(np.isfinite(measurement.positions).any(axis=(1, 2)))
    clocks = [action.clock[seen[action.frames]] if seen.any() else action.clock for action in measurement.actions]
    times = np.unique(np.concatenate(clocks))
    count = min(most, len(times) // _FRAMES)
    if count < 2:
        raise InputError(
            f"a course in time needs at least two knots with {_FRAMES} frames for each; the measurement was seen at "
            f"{len(times)} different times, and {most} knots are allowed"
        )
    ends = np.linspace(0, len(times) - 1, count)
    if stepwise:
        ends = np.maximum(np.linspace(0, len(times), count, endpoint=False).round() - 0.5, 0.0)
    return tuple(np.interp(ends, np.arange(len(times)), times).tolist())


def variant_in_time(state: State, variant: Variant, times: tuple[float, ...], stepwise: bool = False) -> Variant:
    """A variant whose amounts follow a course, see `bcid.forms.course.in_time`; nothing is solved.

    To first order the value at a knot does what a constant amount does, times the weight of the knot at the frame's time. The
    columns, (n, amounts * knots), are whitened like those of other variants, with all knots of the first amount first, so that
    `bcid.inference.evidence.log_gains` takes them: each knot has the prior of the amount.

    Args:
        state: that the variant is of.
        variant: of an effect with constant amounts that are neutral.
        times: of the knots, s.
        stepwise: as of `in_time`.

    Raises:
        InputError: the effect's amounts cannot follow a course.
    """
    term, data = variant.term, state.predictor.data
    effect = in_time(term.effect, times, stepwise)
    course = course_of(effect)
    assert course is not None
    came = [p.name for p in term.effect.shapes if p.off is not None and term.values[p.name] != p.off]
    if came:
        raise InputError(f"{term.effect.name}: {', '.join(came)} is given; only steady amounts can follow a course")
    values = {p.name: term.values[p.name] for p in effect.shapes}
    for p in term.effect.amounts:
        values |= dict.fromkeys(course.names(p.name), term.values[p.name])
    weights = course.weights(state.predictor.times)[data.frame]
    plain = [state.errors.unwhiten(column) for column in variant.sensitivity.T]
    columns = state.errors.whiten(np.hstack([weights * column[:, None] for column in plain]))
    moving = Term(effect, values, place=term.place)
    names = [name for c in variant.amounts for name in course.names(c.parameter.name)]
    return Variant(moving, tuple(amounts(moving, names)), columns)


def time_histories(fitted: Fit) -> tuple[TimeHistory, ...]:
    """Each amount in time of the effects of a model: values at the knots, and how probable such are of a constant one.

    `stderr_from_mean` are standard errors of what each value is from the mean of all, which all may miss alike. They, `stderr` and
    `p_constant` are null where the amount was not fitted, or nothing of it is told.
    """
    return tuple(row for term in fitted.state.model.terms for row in _rows(fitted, term, course_of(term.effect)))


def _rows(fitted: Fit, term: Term, course: Course | None) -> list[TimeHistory]:
    errors, found = fitted.stderr, []
    for p in course.effect.amounts if course else ():
        assert course is not None
        names = course.names(p.name)
        told = [errors.get(term.full(name), math.inf) for name in names]
        constant = _p_value(fitted, term, names, np.diff(np.eye(len(names)), axis=0), 0.0)
        found.append(
            TimeHistory(
                effect=course.effect.name,
                place=term.place,
                amount=p.name,
                unit=p.unit,
                stepwise=course.stepwise,
                times=tuple(map(float, course.times)),
                values=tuple(term.values[name] for name in names),
                stderr=tuple(error if error < UNTOLD else None for error in told),
                stderr_from_mean=_apart(fitted, term, names),
                p_constant=constant,
                changes=None if constant is None else constant <= THRESHOLDS.surprise,
            )
        )
    return found


def seen(fitted: Fit, term: Term, least: float) -> bool:
    """Whether an amount in time differs from nothing by more than chance makes of it with a probability of `least`."""
    course, model = course_of(term.effect), fitted.state.model
    for p in course.effect.amounts if course else ():
        assert course is not None
        names, neutral = course.names(p.name), model.neutral(p)
        assert neutral is not None
        chance = _p_value(fitted, term, names, np.eye(len(names)), neutral)
        if chance is not None and chance < least:
            return True
    return False


def _p_value(fitted: Fit, term: Term, names: Sequence[str], contrasts: Array, none: float) -> float | None:
    """How probable values that differ so much from none are, all together; None where that is not told.

    Errors of knots go together: what one of them is told to miss may be less than all miss alike.
    """
    covariance = _covariance(fitted, term, names, contrasts)
    if covariance is None or np.diag(covariance).max() > UNTOLD**2:
        return None
    apart = contrasts @ (np.array([term.values[name] for name in names]) - none)
    return chi2_tail(float(apart @ np.linalg.lstsq(covariance, apart)[0]), len(contrasts))


def _apart(fitted: Fit, term: Term, names: Sequence[str]) -> tuple[float | None, ...]:
    count = len(names)
    covariance = _covariance(fitted, term, names, np.eye(count) - 1 / count)
    errors = np.full(count, math.inf) if covariance is None else np.sqrt(np.diag(covariance))
    return tuple(float(error) if error < UNTOLD else None for error in errors)


def _covariance(fitted: Fit, term: Term, names: Sequence[str], contrasts: Array) -> Array | None:
    """Of sums of values with these weights, shape (sums, values); None where not all of them were fitted."""
    index = {c.name: k for k, c in enumerate(fitted.coordinates)}
    rows = [index[term.full(name)] for name in names if term.full(name) in index]
    if len(rows) < len(names):
        return None
    return np.asarray(contrasts @ fitted.covariance[np.ix_(rows, rows)] @ contrasts.T)
