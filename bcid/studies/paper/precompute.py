"""What every set predicts on every level, and what the truth is: computed once for all trials, and kept on disk.

Noise, registration and the errors of the camera change no prediction: a thousand trials cost as much as one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.fingerprint import fingerprint
from bcid.exploration.predictions import PullPredictor
from bcid.forms.model import check_physics
from bcid.measurement import Action
from bcid.scene import Scene
from bcid.search.identify_run import scene_fingerprint
from bcid.search.seeds import all_candidates
from bcid.studies.paper.condition import Condition
from bcid.studies.paper.study_file import Trial

Array = NDArray[np.float64]
Candidate = frozenset[str]
# Sets of a task: the solutions of one level share what their solver has built, and a task should not take minutes.
_SETS = {0: 64, 1: 64}
_FINE = 16


@dataclass(frozen=True)
class Store:
    """Predictions of a scene on disk, for one process.

    Attributes:
        scene: the scene file.
        folder: where predictions are kept.
    """

    scene: Path
    folder: Path

    def read(self) -> Scene:
        """The scene."""
        return _scene(self.scene)

    def table(self, condition: Condition, level: int) -> dict[Candidate, Array]:
        """Positions (frames, fiducials, 3), m, that every set predicts on a level; NaN where it has no solution."""
        return _table(self, _plain(condition), level)

    def truth(self, condition: Condition, anchors: Candidate, actions: list[Action] | None = None) -> Array:
        """Positions (frames, fiducials, 3), m, that are true; `actions` where they are other than the condition's.

        Raises:
            SolveError: the true body cannot be followed.
        """
        predictor = _predictor(self, _true(condition), 0)
        driven = actions or condition.actions()
        found = predictor.predict([(anchors, action) for action in driven])
        if any(predicted.failed for predicted in found):
            raise SolveError(f"the truth with {' '.join(sorted(anchors))} anchored cannot be followed")
        return np.concatenate([predicted.positions for predicted in found])


def _plain(condition: Condition) -> Condition:
    """What predictions depend on."""
    return replace(Condition(), anchors=(), motion=condition.motion, grasp=condition.grasp, finest=condition.finest)


def _true(condition: Condition) -> Condition:
    """What the truth depends on, but for the sets."""
    names = ("true_degree", "true_size", "young", "poisson", "shift", "effects")
    same = {name: getattr(condition, name) for name in names}
    return replace(Condition(), anchors=(), motion=condition.motion, grasp=condition.grasp, **same)


@lru_cache(maxsize=4)
def _scene(path: Path) -> Scene:
    return Scene.read(path, physics=check_physics)


@lru_cache(maxsize=12)
def _table(store: Store, condition: Condition, level: int) -> dict[Candidate, Array]:
    scene = store.read()
    every = all_candidates(list(scene.patches))
    actions = condition.actions()
    predictor = _predictor(store, None, level)
    found = predictor.predict([(anchors, action) for anchors in every for action in actions])
    each = [found[i : i + len(actions)] for i in range(0, len(found), len(actions))]
    return {a: np.concatenate([f.positions for f in parts]) for a, parts in zip(every, each, strict=True)}


# What was used last comes last.
_PREDICTORS: dict[tuple[Store, Condition | None, int], PullPredictor] = {}
_MOST = 6


def _predictor(store: Store, true: Condition | None, level: int) -> PullPredictor:
    """PullPredictor of a level of the scene, or of the truth; nothing is meshed before something is to be computed."""
    from mpi4py import MPI

    key = store, true, level
    found = _PREDICTORS.pop(key, None)
    if found is None:
        scene = store.read() if true is None else true.truth(store.read())
        found = PullPredictor(scene, level, MPI.COMM_SELF, store.folder)
    _PREDICTORS[key] = found
    if len(_PREDICTORS) > _MOST:
        _PREDICTORS.pop(next(iter(_PREDICTORS))).destroy()
    return found


def tasks(trials: Iterable[Trial], scene: Scene) -> dict[str, dict[str, Any]]:
    """What is to be predicted for trials, those that take longest first."""
    truths: dict[Condition, set[Candidate]] = {}
    levels: dict[tuple[Condition, int], None] = {}
    for trial in trials:
        condition = trial.condition
        if not condition.robot_turn:
            truths.setdefault(_true(condition), set()).add(condition.held(trial.number))
        if condition.search != "identify":
            levels |= {(_plain(condition), level): None for level in range(condition.finest + 1)}
    found: list[dict[str, Any]] = [
        {"condition": true.to_json(), "level": None, "sets": [sorted(anchors)]}
        for true, sets in truths.items()
        for anchors in sorted(sets, key=sorted)
    ]
    every = sorted(all_candidates(list(scene.patches)), key=lambda c: (len(c), sorted(c)))
    for plain, level in sorted(levels, key=lambda pair: -pair[1]):
        size = _SETS.get(level, _FINE)
        found += [
            {"condition": plain.to_json(), "level": level, "sets": [sorted(c) for c in every[i : i + size]]}
            for i in range(0, len(every), size)
        ]
    about = scene_fingerprint(scene)
    return {fingerprint([about, task]): task for task in found}


def maker(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that predicts, for `bcid.studies.engine.dispatch`; `job` holds the `scene` file and the folder `predictions`."""
    store = Store(Path(job["scene"]), Path(job["predictions"]))

    def precompute(task: Mapping[str, Any]) -> dict[str, Any]:
        condition, level = Condition.from_json(task["condition"]), task["level"]
        predictor = _predictor(store, None if level is not None else condition, level or 0)
        # What is built once for all sets does not count as their time.
        predictor.forward()
        began = time.process_time()
        wanted = [(frozenset(names), action) for names in task["sets"] for action in condition.actions()]
        found = predictor.predict(wanted)
        seconds = (time.process_time() - began) / len(task["sets"])
        return {"failed": sum(f.failed for f in found), "seconds": round(seconds, 4), "level": level}

    return precompute
