"""Which sets of anchors to begin with: the likely ones as a few steps of each action show them, without knowing what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.progress import Steps
from bcid.comparison.coarse_search import CoarseSearch
from bcid.comparison.few_steps import FEW_STEPS, few_steps
from bcid.comparison.fitted_hypothesis import weighed
from bcid.comparison.state import State
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.continuation import ContinuationError
from bcid.inference.mesh_error import MeshError
from bcid.predict.predictor import Predictor
from bcid.scene import Scene
from bcid.search.set_misfits import staged_sets
from bcid.search.settings import SETTINGS
from bcid.search.stages import StageOptions

Anchored = frozenset[str]
# Where none of them can be followed the coarsest level is climbed from so many seeds, with steps halved so often.
_SEEDS, _HALVINGS = 2, 3
# A set with which the body would buckle again and again is given up early.
_LARGE_STEPS = Settings(rtol=1e-7, halvings=0)


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
