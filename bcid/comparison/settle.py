"""A model at the stiffness that forces and loads tell: what acts besides is nearly linear about it."""

from __future__ import annotations

from bcid.comparison.fit import Fit, fit
from bcid.comparison.state import State

# Under loads so many steps at most, by no more than this factor each; below this part of a standard error nothing changes.
_STEPS, _FACTOR, _STILL = 6, 2.0, 0.3


def settled(state: State) -> State:
    """The state at that stiffness; as it is where nothing tells it; collective.

    The force of a gripper is proportional to the stiffness, and one step tells it. How far loads move the body is not, and
    Newton's steps go on until they change nothing; a law with one such constant has it as a number that is fitted with all others.

    Raises:
        SolveError: the model cannot be followed with a stiffness on the way.
    """
    if state.predictor.forces is not None:
        told = Fit.at(state).stiffness
        return _with(state, told.values) if told else state
    for _ in range(_STEPS):
        told = Fit.at(state).stiffness
        if told is None:
            return state
        if abs(told.log) < _STILL * told.log_error:
            break
        factor = min(max(told.factor, 1 / _FACTOR), _FACTOR)
        state = _with(state, {name: factor * value for name, value in told.constants.items()})
    names = tuple(state.model.stiffnesses)
    return fit(state, names).state if len(names) == 1 else state


def _with(state: State, values: dict[str, float]) -> State:
    return State.of(state.predictor, state.model.with_values(values), state.anchors)
