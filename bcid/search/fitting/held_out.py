"""How well actions are predicted from each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError, evaluating
from bcid.inference.error_covariance import ErrorCovariance
from bcid.search.fitting.fit import Fit, fit, pulls

Array = NDArray[np.float64]
# A linear step stands for a fit where what it promises of the action comes true within this part of the noise (RMS).
_TRUE = 0.3
# A fit without an action, which begins at the fit to all, takes so many predictions at most, and ends at this relative change of
# chi-square.
_MOST, _ROUGH = 8, 2e-3


def held_out(fitted: Fit) -> float | None:
    """RMS residual, m, when each action is predicted from a fit to the others; collective.

    The others give the parameters of the model, and what the scene may have slightly wrong (`ErrorCovariance.expected`): an
    action is predicted with both. The fit without it is one Gauss-Newton step from the fit to all, with its Jacobian, and
    where the action does not move as the step promises, one in full. None with one action only, and where a fit to the others
    cannot be followed.
    """
    data, count = fitted.state.predictor.data, len(fitted.state.predictor.data.actions)
    if count < 2:
        return None
    squares = 0.0
    for number in range(count):
        try:
            with evaluating("an action held out", fitted.state.predictor.skip):
                residual = _without(fitted, number)
        except SolveError:
            return None
        if residual is None:
            return None
        squares += float(np.sum(residual[data.of_position & (data.action == number)] ** 2))
    return float(np.sqrt(squares / data.of_position.sum()))


def _without(fitted: Fit, number: int) -> Array | None:
    """What a fit without an action misses, (n,), m; None where it cannot be followed."""
    errors = fitted.state.errors.masked(fitted.state.predictor.data.action == number)
    residual = _stepped(fitted, errors, number) if fitted.coordinates else fitted.state.residual
    if residual is None:
        residual = _refitted(fitted, errors)
    return None if residual is None else residual - errors.expected(residual)


def _stepped(fitted: Fit, errors: ErrorCovariance, number: int) -> Array | None:
    """The residual (n,), m, after a linear step, that of the action with solves; None where the step does not stand for a fit."""
    state = fitted.state
    data, predictor = state.predictor.data, state.predictor
    slopes = np.column_stack([state.errors.unwhiten(column) for column in fitted.jacobian.T])
    step = _step(fitted, errors, slopes)
    values = _moved(fitted, step)
    if values is None:
        return None
    prediction = predictor.predict(state.model.with_values(values), state.anchors, actions=[predictor.actions[number]])
    if prediction.failure:
        return None
    promised = state.residual + slopes @ step
    found = data.values - data.vector(prediction.positions + state.errors.mesh.correction)
    here = data.action == number
    missed = (found - promised)[here] / state.errors.sigma[here]
    return np.where(here, found, promised) if np.sqrt(np.mean(missed**2)) <= _TRUE else None


def _step(fitted: Fit, errors: ErrorCovariance, slopes: Array) -> Array:
    """From the fit to all to one with errors that see only some of the values, shape (p,)."""
    chosen, numbers = fitted.coordinates, fitted.state.model.constants()
    scale = np.array([c.scale for c in chosen])
    x = np.array([c.of(numbers[c.name]) for c in chosen]) / scale
    pull, expected = pulls(fitted.state.model, chosen)
    rows = errors.whiten(slopes * scale)
    ridge = pull.T @ pull + 1e-6 * max(float(np.abs(rows.T @ rows).max(initial=0.0)), 1e-12) * np.eye(len(x))
    slope = rows.T @ errors.whiten(fitted.state.residual) + pull.T @ pull @ (x - expected)
    return np.asarray(-np.linalg.solve(rows.T @ rows + ridge, slope) * scale)


def _moved(fitted: Fit, step: Array) -> dict[str, float] | None:
    """Values after a step; None where a bound is in its way, so that it ends elsewhere than a fit would."""
    numbers, values = fitted.state.model.constants(), {}
    for c, by in zip(fitted.coordinates, step, strict=True):
        (lower, upper), before = c.bounds, c.of(numbers[c.name])
        to = before + by
        # A number that is at its bound already may be pushed against it.
        free = lower <= to <= upper or min(before - lower, upper - before) < 1e-3 * c.scale
        if not free:
            return None
        values[c.name] = c.allowed(float(np.clip(to, lower, upper)))
    return values


def _refitted(fitted: Fit, errors: ErrorCovariance) -> Array | None:
    """The residual (n,), m, of a fit with these errors, with solves; None where it cannot be followed."""
    try:
        return fit(replace(fitted.state, errors=errors), fitted.state.free, most=_MOST, ftol=_ROUGH).state.residual
    except SolveError:
        return None
