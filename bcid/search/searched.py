"""Where a search over hypotheses begins, and how it is repeated without frames in which the body buckles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.options import StageOptions
from bcid.base.progress import Steps
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.continuation import ContinuationError
from bcid.inference.data import robust_noise
from bcid.inference.mesh_error import MeshError
from bcid.predict.predictor import Predictor
from bcid.scene import Scene
from bcid.search.coarse_search import CoarseSearch
from bcid.search.fitting.buckled_frames import leave_out
from bcid.search.fitting.fit import Fit, fit
from bcid.search.fitting.fitted_hypothesis import weighed
from bcid.search.fitting.state import FEW_STEPS, State, few_steps
from bcid.search.full_search import FullSearch
from bcid.search.set_misfits import staged_sets
from bcid.search.settings import SETTINGS

Anchored = frozenset[str]
# Where none of them can be followed the coarsest level is climbed from so many seeds, with steps halved so often.
_SEEDS, _HALVINGS = 2, 3
# A set with which the body would buckle again and again is given up early.
_LARGE_STEPS = Settings(rtol=1e-7, halvings=0)
# Under loads so many steps at most, by no more than this factor each; below this part of a standard error nothing changes.
_STEPS, _FACTOR, _STILL = 6, 2.0, 0.3


def searched(
    predictor: Predictor,
    model: Model,
    likely: Sequence[Anchored],
    search: Callable[[State, Sequence[Anchored]], FullSearch],
) -> FullSearch:
    """The search that has run; collective.

    A few steps may take a body that buckles for another one. Where something is missing beside the likeliest set, and the body
    buckles with it, what was seen from there on is left out and the search is begun anew.

    Args:
        predictor: of the measurement.
        model: without added effects.
        likely: sets to take for the likely ones, where an earlier search knows them.
        search: makes the search from the model with a likely set and all likely sets.

    Raises:
        ContinuationError: no anchor set can be followed to the end with the model.
    """
    base, sets = first_state(predictor, model, likely)
    asked = {base.anchors}
    while True:
        found = search(base, sets)
        best = found.run().odds.best
        if best.anchors in asked or not (best.names or best.unknown):
            return found
        asked.add(best.anchors)
        if not leave_out(predictor, model, best.anchors):
            return found
        sets = first_sets(predictor, model)
        base = settled_state(predictor, model, sets[0])


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


def first_sets(predictor: Predictor, model: Model) -> list[Anchored]:
    """Likely sets, the first of which the working level can be followed with; collective.

    Raises:
        ContinuationError: no set can be followed to the end, or one that cannot is likelier on the frames before.
    """
    sets, lost = _seen(predictor, model)
    for number, anchors in enumerate(sets):
        if not predictor.predict(model, anchors, keep=True).failure:
            return [*_recovered(predictor, model, lost, anchors), *sets[number:]]
    level = predictor.level
    options = StageOptions(coarsest=level, finest=level)
    return _climbed(predictor, predictor.scene, options, model, _LARGE_STEPS, sets)[:1]


def _recovered(predictor: Predictor, model: Model, lost: Sequence[Anchored], best: Anchored) -> list[Anchored]:
    """Those of some sets that are followed to the end in small steps.

    Where solves fail says nothing about a set. If one explains what comes before better than the best that is followed further,
    and something unknown would have to act with that, what comes after is not compared.
    """
    found = []
    for anchors in lost[: SETTINGS.recovered_sets]:
        try:
            State.of(predictor, model, anchors, MeshError.unknown(predictor.data.mask.shape))
        except ContinuationError as error:
            if _outdone(predictor, model, error, anchors, best):
                raise
        else:
            found.append(anchors)
    return found


def _outdone(predictor: Predictor, model: Model, error: ContinuationError, anchors: Anchored, best: Anchored) -> bool:
    """Whether another set is worse than one that cannot be followed any further, on the frames that this can be followed in."""
    try:
        before = predictor.repeating(error.before(predictor.measurement))
        nothing = MeshError.unknown(before.data.mask.shape)
        here, there = (weighed(State.of(before, model, a, nothing), model) for a in (anchors, best))
    except SolveError:
        return False
    return there.forced > there.plain and here.total > there.total + SETTINGS.comparable


def _seen(predictor: Predictor, model: Model) -> tuple[list[Anchored], list[Anchored]]:
    """The likely sets with something unknown besides, and those that could not be followed though likelier; the likeliest first."""
    thin, _ = predictor.thinned(few_steps(predictor), FEW_STEPS)
    for anchors in _openings(predictor, model):
        with suppress(SolveError):
            state = State.of(thin, model, anchors, MeshError.unknown(thin.data.mask.shape))
            table = CoarseSearch(state, model, sets=SETTINGS.first_sets).run()
            return table.sets, table.lost
    return _climbed_coarsely(predictor, model), []


def _openings(predictor: Predictor, model: Model) -> list[Anchored]:
    """Sets whose tangents may be asked about all others: all patches, which hold the body firmly, and fewer and fewer of them.

    Where a patch is near the gripper the body may not be followed with it: those far from where it grips stay longest.
    """
    scene, mesh = predictor.scene, predictor.forward(model).mesh
    grips = [scene.grasps[action.grasp].centre for action in predictor.actions if action.grasp]
    away = {}
    for name, region in scene.patches.items():
        middle = mesh.points[np.unique(mesh.select(region, f"patch {name}"))].mean(axis=0)
        away[name] = min((float(np.linalg.norm(middle - np.array(grip))) for grip in grips), default=0.0)
    far = sorted(away, key=lambda name: (-away[name], name))
    counts = dict.fromkeys((len(far), (len(far) + 1) // 2, 1, 0))
    return [frozenset(far[:count]) for count in counts]


def _climbed_coarsely(predictor: Predictor, model: Model) -> list[Anchored]:
    """The likely sets on the coarsest level, with a few steps of each action that may be halved more often."""
    thin, frames = predictor.thinned(few_steps(predictor), Settings(rtol=1e-6, halvings=_HALVINGS))
    options = StageOptions(seeds=_SEEDS, finest=0)
    try:
        return _climbed(thin, thin.whole, options, model, thin.settings)[: SETTINGS.first_sets]
    except ContinuationError as error:
        raise ContinuationError(str(error), error.remark, _came_to(predictor, frames[error.frames])) from None


def _climbed(
    predictor: Predictor,
    scene: Scene,
    options: StageOptions,
    model: Model,
    settings: Settings,
    start: Sequence[Anchored] = (),
) -> list[Anchored]:
    """The sets that climbing on levels of a scene finds likely, the likeliest first."""
    measurement, comm, steps = predictor.measurement, predictor.comm, Steps(predictor.progress)
    found = staged_sets(scene, measurement, comm, options, model, settings, steps, start)
    predictor.count("coarse", sum(found.evaluations.values()))
    return list(found.likely)


def _came_to(predictor: Predictor, frames: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of all frames were come to, where these were."""
    found = np.zeros(len(predictor.data.mask), dtype=bool)
    for action in predictor.actions:
        found[action.frames] = action.frames <= max(np.intersect1d(action.frames, frames), default=-1)
    return found


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
