"""How well actions are predicted from each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.comparison.fit import Fit, pulls

Array = NDArray[np.float64]


def held_out(fitted: Fit) -> float | None:
    """RMS residual, m, when each action is predicted from a fit to the others; collective.

    The fit without an action is one Gauss-Newton step from the fit to all, with its Jacobian. None with one action only, and
    where a fit to the others cannot be followed.
    """
    state = fitted.state
    data, count = state.predictor.data, len(state.predictor.data.actions)
    if count < 2:
        return None
    if not fitted.coordinates:
        return state.rms
    squares = 0.0
    for number in range(count):
        residual = _without(fitted, number)
        if residual is None:
            return None
        squares += float(np.sum(residual[data.of_position & (data.action == number)] ** 2))
    return float(np.sqrt(squares / data.of_position.sum()))


def _without(fitted: Fit, number: int) -> Array | None:
    """The residual (n,), m, of a fit without an action, at least in that; None where it cannot be followed."""
    state = fitted.state
    data, predictor, others = state.predictor.data, state.predictor, state.predictor.data.action != number
    values = _moved(fitted, _step(fitted, others))
    prediction = predictor.predict(state.model.with_values(values), state.anchors, actions=[predictor.actions[number]])
    if prediction.failure:
        return None
    return np.asarray(data.values - data.vector(prediction.positions + state.errors.mesh.correction))


def _step(fitted: Fit, others: NDArray[np.bool_]) -> Array:
    """From the fit to all to one to some of the values, in units of the scales, shape (p,)."""
    chosen, numbers = fitted.coordinates, fitted.state.model.constants()
    scale = np.array([c.scale for c in chosen])
    x = np.array([c.of(numbers[c.name]) for c in chosen]) / scale
    pull, expected = pulls(fitted.state.model, chosen)
    rows = fitted.jacobian[others] * scale
    ridge = pull.T @ pull + 1e-6 * max(float(np.abs(rows.T @ rows).max(initial=0.0)), 1e-12) * np.eye(len(x))
    slope = rows.T @ fitted.state.scaled[others] + pull.T @ pull @ (x - expected)
    return np.asarray(-np.linalg.solve(rows.T @ rows + ridge, slope))


def _moved(fitted: Fit, step: Array) -> dict[str, float]:
    """Values after a step in units of the scales, within their bounds."""
    numbers, values = fitted.state.model.constants(), {}
    for c, by in zip(fitted.coordinates, step, strict=True):
        lower, upper = c.bounds
        values[c.name] = c.allowed(float(np.clip(c.of(numbers[c.name]) + by * c.scale, lower, upper)))
    return values
