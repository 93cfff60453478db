"""What a prediction has wrong because what the scene has slightly wrong is integrated over to first order.

A body near an instability bends away from its tangent long before it gives way: a turn of the gripper by a degree, or a thickness
that is 3 % off, moves it by twice what the sensitivities say, which passes for an effect that is not there. So it is predicted once
more with all of them at their likeliest values, and by what their sensitivities miss there each action may be off
(Bates & Watts, Nonlinear Regression Analysis and Its Applications, 1988, chapter 7).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import evaluating
from bcid.forms.model import Model, Term
from bcid.inference.knots import Knots
from bcid.predict.mesh_ladder import states_in
from bcid.predict.predictor import Predictor
from bcid.search.fitting.fit import Fit, coordinates, fit
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
# Less than this part of the noise of an action is left out. What is further off than so many standard deviations is not believed.
_SEEN, _MOST = 0.2, 3.0
# How far sensitivities miss need not be known as well as positions, nor that the states are stable.
_RTOL = 3e-5
# A fit that allows for it begins at one that did not.
_AGAIN = 4


def bent(found: Fit) -> Fit:
    """A fit to all steps, which allows for that; collective.

    Raises:
        SolveError: the influence of its numbers cannot be followed.
    """
    state = found.state
    with evaluating(f"curvature of {state.model.name}", state.predictor.skip):
        columns = curvature(state)
    if not columns.size:
        return found
    modes = state.whole_modes.without([""]).beside(columns)
    return fit(state.with_errors(state.errors.mesh, modes), state.free, most=_AGAIN, like=found)


def curvature(state: State) -> Array:
    """What the sensitivities to nuisances miss at their likeliest values, by action, (n, k), m; collective.

    Of those actions in which that is no less than a part of the noise, and which can be followed so. Borders of patches and where
    markers sit are left to first order.
    """
    predictor, data = state.predictor, state.predictor.data
    likely = [_Likely(state, number) for number in range(len(data.actions))]
    moved = data.vector(_moved(predictor, state, [one.model for one in likely]))
    columns = [np.where(one.rows, moved - one.expected, 0.0) for one in likely]
    # Of what cannot be followed nothing is known.
    sizes = [np.sqrt(np.mean((c / state.errors.sigma)[one.rows] ** 2)) for c, one in zip(columns, likely, strict=True)]
    return np.column_stack(
        [*(c for c, size in zip(columns, sizes, strict=True) if size > _SEEN), np.zeros((len(data), 0))]
    )


def allowed(state: State) -> dict[str, float]:
    """RMS of what is allowed for so, by the action in which it is, m."""
    data, modes = state.predictor.data, state.errors.nuisances
    found = {}
    for column in modes.common[:, modes.of([""])].T:
        own = data.action == data.action[np.flatnonzero(column)[0]]
        found[data.actions[int(data.action[own][0])]] = float(np.sqrt(np.mean(column[own] ** 2)))
    return found


def _moved(predictor: Predictor, state: State, models: Iterable[Model]) -> Array:
    """How far fiducials are with a model for each action from where they are with that of a state, (frames, rows, 3), m.

    It is known in a few steps, and interpolated between them; in all where the model remembers them or something happens in one.
    """
    prediction, by, known = state.prediction, predictor, list[Knots]()
    frames: NDArray[np.int64] = np.arange(len(prediction.positions))
    if not (predictor.thin or state.model.remembers or state.model.jumps):
        # At rest the gripper is where it is reported to be.
        ends = zip(predictor.actions, predictor.last_seen(), strict=True)
        known = [Knots.of(action, 1, last, timed=not state.model.steady) for action, last in ends]
        steps = [np.union1d(0, k.steps) for k in known]
        by, frames = predictor.in_steps(steps, replace(predictor.settings, rtol=_RTOL, pivots=False, halvings=0))
    near = states_in(prediction, frames)
    moved = np.full(prediction.positions.shape, np.nan)
    for action, model in zip(by.actions, models, strict=True):
        there, here = by.predict(model, state.anchors, actions=[action], near=near), frames[action.frames]
        moved[here] = there.positions[action.frames] - prediction.positions[here]
    for one in known:
        one.fill(moved)
    return moved


class _Likely:
    """A model in an action with what the scene has slightly wrong at its likeliest.

    Args:
        state: with the model, compared with the data.
        number: of the action.

    Attributes:
        rows: which values are of the action, shape (n,).
        model: with that.
        expected: what the sensitivities say that this changes, shape (n,), m.
    """

    def __init__(self, state: State, number: int) -> None:
        data, modes = state.predictor.data, state.errors.nuisances
        self.rows = data.action == number
        self.expected = np.zeros(len(data))
        terms: dict[int, tuple[Term, dict[str, float]]] = {}
        law: dict[str, float] = {}
        means = np.clip(state.errors.likeliest(state.residual), -_MOST, _MOST)
        numbers = modes.numbers or (None,) * len(modes.names)
        for name, column, mean, of in zip(modes.names, modes.common.T, means, numbers, strict=True):
            if not column[self.rows].any() or name == "borders" or (of is None and name != "poisson"):
                continue
            value = float(mean) * modes.sizes[name]
            if of is None:
                law[name] = value
            else:
                terms.setdefault(id(of[0]), (of[0], {}))[1][of[1]] = value
            self.expected += mean * column
        self.model = _with(state.model, law, terms.values())


def _with(model: Model, law: Mapping[str, float], terms: Iterable[tuple[Term, Mapping[str, float]]]) -> Model:
    """A model with constants of its law changed by so much, as far as they may be, and effects with these values besides."""
    constants = {
        c.name: c.allowed(float(model.constants()[c.name]) + law[c.name]) for c in coordinates(model, list(law))
    }
    added = [
        Term(term.effect, {**term.values, **values}, f"{term.effect.name} {number}", term.place)
        for number, (term, values) in enumerate(terms)
    ]
    return replace(model.with_values(constants), terms=(*model.terms, *added))
