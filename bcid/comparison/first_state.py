"""Where a search over hypotheses begins: the model with a likely set, and the noise that is believed."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from bcid.base.errors import SolveError
from bcid.comparison.buckled_frames import leave_out
from bcid.comparison.first_sets import first_sets
from bcid.comparison.settle import settled
from bcid.comparison.state import State
from bcid.forms.model import Model
from bcid.inference.data import robust_noise
from bcid.predict.predictor import Predictor

Anchored = frozenset[str]


def first_state(predictor: Predictor, model: Model, likely: Sequence[Anchored] = ()) -> tuple[State, list[Anchored]]:
    """The model with a likely set, on what was seen before the body buckles with it, and all likely sets; collective.

    Args:
        predictor: of the measurement.
        model: without added effects.
        likely: sets to take for these, where an earlier search knows them.

    Raises:
        ContinuationError: no anchor set can be followed to the end with the model.
    """
    predictor.progress.step("looking for the likely anchors in a few steps")
    sets = list(likely) if _follows(predictor, model, likely) else first_sets(predictor, model)
    if leave_out(predictor, model, sets[0]):
        sets = first_sets(predictor, model)
    return settled_state(predictor, model, sets[0]), sets


def settled_state(predictor: Predictor, model: Model, anchors: Anchored) -> State:
    """The model with a set, with the noise that is believed; collective."""
    base = State.of(predictor, model, anchors)
    with suppress(SolveError):
        base = settled(base)
    return _with_noise(base)


def _follows(predictor: Predictor, model: Model, sets: Sequence[Anchored]) -> bool:
    """Whether there are sets the first of which the model can be followed with."""
    return bool(sets) and not predictor.predict(model, sets[0], keep=True).failure


def _with_noise(base: State) -> State:
    """The state with the noise that its residual has where none is stated, or where that is surprisingly another."""
    predictor, data = base.predictor, base.predictor.data
    found = robust_noise(data, base.rough_values)
    if found is None or (data.stated and not found.surprising):
        return base
    if not data.stated:
        # What the mesh leaves is no more known than so: of smooth data without noise nothing would ever be doubted.
        found = replace(found, sigma=max(found.sigma, base.errors.mesh_rms))
    predictor.believe(found)
    predictor.progress.say(f"the measurement has a noise of {found.sigma * 1e3:.3g} mm")
    return State.of(predictor, base.model, base.anchors, base.errors.mesh, base.free, base.prediction)
