"""What every set predicts on every level, and what the truth is: computed once for all trials, and kept on disk.

Noise, registration and the errors of the camera change no prediction: a thousand trials cost as much as one. What is wrong with the
robot or the grasp changes the truth of a trial, which is then its own; cells that differ by noise alone share it.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.fingerprint import fingerprint
from bcid.base.run_folder import writing
from bcid.forms.model import check_physics
from bcid.measurement import Measurement
from bcid.predict.pull_predictor import PullPredictor
from bcid.predict.store import PredictionStore
from bcid.scene import Scene
from bcid.search.hill_climbing import all_candidates
from validation.paper.condition import Condition
from validation.paper.study_file import Trial
from validation.paper.trial_errors import body_differs, differs, true_actions, true_scene

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
        seed: of what is random in the trials.
    """

    scene: Path
    folder: Path
    seed: int

    def read(self) -> Scene:
        """The scene."""
        return _scene(self.scene)

    def sets(self) -> list[Candidate]:
        """Every set of patches."""
        return all_candidates(list(self.read().patches))

    def predicted(self, condition: Condition, level: int, anchors: Candidate) -> Array:
        """Positions (frames, fiducials, 3), m, that a set predicts on a level; NaN where it has no solution.

        Sets that were not computed before are computed.
        """
        known = _table(self, _plain(condition), level)
        if anchors not in known:
            known[anchors] = _positions(_predictor(self, None, 0, level), condition, [anchors])[0]
        return known[anchors]

    def truth(self, condition: Condition, number: int) -> Array:
        """Positions (frames, fiducials, 3), m, that are true in a trial.

        Raises:
            SolveError: the true body cannot be followed.
        """
        predictor = _predictor(self, _true(condition), number, 0)
        anchors = condition.held(number)
        found = predictor.predict([(anchors, action) for action in true_actions(condition, number, self.seed)])
        if any(predicted.failed for predicted in found):
            raise SolveError(f"the truth with {' '.join(sorted(anchors))} anchored cannot be followed")
        return np.concatenate([predicted.positions for predicted in found])

    def film(self, condition: Condition, number: int) -> Measurement:
        """What the images of a trial tell; filmed once and kept.

        Raises:
            BcidError: see `validation.paper.filmed.filmed`.
        """
        from validation.paper.filmed import filmed

        scene = self.read()
        alone = replace(_true(condition), anchors=(tuple(sorted(condition.held(number))),))
        about = [scene.fingerprint(), alone.to_json(), number, self.seed]
        folder = self.folder / "filmed" / fingerprint(about)
        if not folder.is_dir():
            measurement = filmed(condition, scene, number, self.seed)
            with writing(folder.parent):
                folder.parent.mkdir(parents=True, exist_ok=True)
                begun = Path(tempfile.mkdtemp(prefix=".film-", dir=folder.parent)) / "measurement"
                measurement.write(begun)
                # Where another process was as fast, its folder stays.
                with suppress(OSError):
                    begun.rename(folder)
                shutil.rmtree(begun.parent)
        return Measurement.read(folder)


def _plain(condition: Condition) -> Condition:
    """What predictions depend on."""
    return replace(Condition(), anchors=(), **{name: getattr(condition, name) for name in _DRIVEN})


_DRIVEN = ("motion", "grasp", "steps")
_TRUE = ("true_degree", "true_size", "young", "poisson", "effects")
_TRIAL = ("robot_turn", "robot_noise", "grasp_error", "placement")


def _true(condition: Condition) -> Condition:
    """What the truth depends on, but for the set and the number of the trial."""
    same = {name: getattr(condition, name) for name in (*_DRIVEN, *_TRUE, *_TRIAL)}
    return replace(Condition(), anchors=(), **same)


@lru_cache(maxsize=4)
def _scene(path: Path) -> Scene:
    return Scene.read(path, physics=check_physics)


def _positions(predictor: PullPredictor, condition: Condition, sets: list[Candidate]) -> list[Array]:
    actions = condition.actions()
    found = predictor.predict([(anchors, action) for anchors in sets for action in actions])
    each = [found[i : i + len(actions)] for i in range(0, len(found), len(actions))]
    return [np.concatenate([f.positions for f in parts]) for parts in each]


@lru_cache(maxsize=16)
def _table(store: Store, condition: Condition, level: int) -> dict[Candidate, Array]:
    """What is known of the sets on a level; for one on which all are computed, all that."""
    return {}


# What was used last comes last.
_PREDICTORS: dict[tuple[Any, ...], PullPredictor] = {}
_MOST = 6


def _predictor(store: Store, true: Condition | None, number: int, level: int) -> PullPredictor:
    """PullPredictor of a level of the scene, or of the truth of a trial; nothing is meshed before something is to be computed."""
    from mpi4py import MPI

    key = store, true, number if true is not None and body_differs(true) else 0, level
    found = _PREDICTORS.pop(key, None)
    if found is None:
        scene = store.read() if true is None else true_scene(true, store.read(), number, store.seed)
        found = PullPredictor(scene, level, MPI.COMM_SELF, PredictionStore(store.folder, MPI.COMM_SELF, shared=True))
    _PREDICTORS[key] = found
    if len(_PREDICTORS) > _MOST:
        _PREDICTORS.pop(next(iter(_PREDICTORS))).destroy()
    return found


def tasks(trials: Iterable[Trial], scene: Scene, seed: int) -> dict[str, dict[str, Any]]:
    """What is to be predicted for trials, those that take longest first."""
    truths: dict[tuple[Condition, int], None] = {}
    levels: dict[tuple[Condition, int], None] = {}
    beyond: dict[tuple[Condition, int], set[Candidate]] = {}
    for trial in trials:
        condition, held = trial.condition, trial.condition.held(trial.number)
        film = condition.seen == "images"
        true = replace(_true(condition), anchors=(tuple(sorted(held)),), seen=condition.seen)
        truths[true, trial.number if film or differs(condition) else 0] = None
        if condition.search == "identify":
            continue
        for level in range(condition.finest + 1):
            if level <= condition.compared:
                levels[_plain(condition), level] = None
            else:
                # Computed on demand but for the true sets, which are asked for most and tell what a call takes.
                beyond.setdefault((_plain(condition), level), set()).add(held)
    found: list[dict[str, Any]] = [
        {"condition": true.to_json(), "level": None, "number": number, "seed": seed} for true, number in truths
    ]
    every = sorted(all_candidates(list(scene.patches)), key=lambda c: (len(c), sorted(c)))
    wanted = [(plain, level, sorted(sets, key=sorted)) for (plain, level), sets in beyond.items()]
    wanted += [(plain, level, every) for plain, level in sorted(levels, key=lambda pair: -pair[1])]
    for plain, level, sets in wanted:
        size = _SETS.get(level, _FINE)
        found += [
            {"condition": plain.to_json(), "level": level, "sets": [sorted(c) for c in sets[i : i + size]]}
            for i in range(0, len(sets), size)
        ]
    about = scene.fingerprint()
    return {fingerprint([about, task]): task for task in found}


def maker(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that predicts, for `validation.engine.dispatch`.

    `job` holds the `scene` file, the folder `predictions` and the `seed`.
    """
    store = Store(Path(job["scene"]), Path(job["predictions"]), job["seed"])

    def precompute(task: Mapping[str, Any]) -> dict[str, Any]:
        condition, level = Condition.from_json(task["condition"]), task["level"]
        if level is None:
            make = store.film if condition.seen == "images" else store.truth
            make(condition, task["number"])
            return {"level": None}
        predictor = _predictor(store, None, 0, level)
        # What is built once for all sets does not count as their time.
        predictor.forward()
        began = time.process_time()
        found = _positions(predictor, condition, [frozenset(names) for names in task["sets"]])
        seconds = (time.process_time() - began) / len(found)
        failed = sum(not np.isfinite(positions).all() for positions in found)
        return {"failed": failed, "seconds": round(seconds, 4), "level": level}

    return precompute
