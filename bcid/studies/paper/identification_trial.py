"""A trial of identification: see the truth as a laboratory would, and search for the anchors.

What is wrong with what is seen is drawn from the seed of the study and the number of the trial alone: trials of the same number
in different cells differ by what is varied and by nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.measurement import Action
from bcid.scene import Scene
from bcid.scene.rotation import conjugated, from_vector, rotate
from bcid.search.seeds import random_seeds
from bcid.studies.paper.algorithm1 import Candidate, in_one_stage, in_stages, optimum
from bcid.studies.paper.condition import Condition
from bcid.studies.paper.precompute import Store

Array = NDArray[np.float64]


def maker(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that makes a trial, for `bcid.studies.engine.dispatch`.

    `job` holds the `scene` file, the folder `predictions` and the `seed`; a task the `condition` and the `number`.
    """
    store = Store(Path(job["scene"]), Path(job["predictions"]))

    def trial(task: Mapping[str, Any]) -> dict[str, Any]:
        condition, number = Condition.from_json(task["condition"]), int(task["number"])
        seen = see(store, condition, number, job["seed"])
        search = identified if condition.search == "identify" else climbed
        return search(store, condition, number, seen) | {"anchors": sorted(condition.held(number))}

    return trial


def see(store: Store, condition: Condition, number: int, seed: int) -> Array:
    """Positions as they are measured, shape (frames, fiducials, 3), m."""
    rng = np.random.default_rng([seed, number])
    # Everything is drawn in every trial, so that what is varied changes no other draw.
    shift, axis, spin, scale = rng.normal(size=3), unit(rng.normal(size=3)), rng.normal(), rng.normal()
    robot_axis, robot_spin = unit(rng.normal(size=3)), rng.normal()
    actions = condition.actions()
    if condition.robot_turn:
        turn = from_vector(condition.robot_turn * robot_spin * robot_axis)
        actions = [turned(action, turn) for action in actions]
    true = store.truth(condition, condition.held(number), actions if condition.robot_turn else None)
    middle = store.read().rest.mean(axis=0)
    about = from_vector(condition.camera_turn * spin * axis)
    seen = middle + (1 + condition.camera_scale * scale) * rotate(about, true - middle)
    white = rng.normal(size=true.shape)
    return np.asarray(seen + condition.registration * shift + condition.noise * white)


def unit(vector: Array) -> Array:
    """The vector with length one."""
    return vector / np.linalg.norm(vector)


def turned(action: Action, turn: Array) -> Action:
    """The action in a frame that is turned: its translations and the axes of its rotations."""
    return replace(action, translation=rotate(turn, action.translation), rotation=conjugated(turn, action.rotation))


def rms(predicted: Array, seen: Array) -> float:
    """RMS residual per coordinate, m; infinite where there is no prediction."""
    error = predicted - seen
    return float(np.sqrt(np.mean(error**2))) if np.isfinite(error).all() else float("inf")


def climbed(store: Store, condition: Condition, number: int, seen: Array) -> dict[str, Any]:
    """Algorithm 1 of the paper, and the best of all sets, on what was precomputed."""
    scene = store.read()
    tables = [store.table(condition, level) for level in range(condition.finest + 1)]
    misfits: dict[tuple[int, Candidate], float] = {}

    def misfit(level: int, candidate: Candidate) -> float:
        key = level, candidate
        if key not in misfits:
            misfits[key] = rms(tables[level][candidate], seen)
        return misfits[key]

    patches = list(scene.patches)
    seeds = random_seeds(patches, condition.seeds, np.random.default_rng(number))
    search = in_stages if condition.search == "stages" else in_one_stage
    found = search(misfit, patches, seeds, condition.finest)
    best = optimum(misfit, tables[condition.finest], condition.finest)
    truth = condition.held(number)
    return {
        "found": sorted(found.anchors),
        "right": found.anchors == truth,
        "best": sorted(best),
        "best_right": best == truth,
        "rms": misfit(condition.finest, found.anchors),
        "calls": {str(level): float(count) for level, count in found.calls.items()},
        "cpu_seconds": None,
    }


def identified(store: Store, condition: Condition, number: int, seen: Array) -> dict[str, Any]:
    """What `bcid identify` finds, with its own calls of the model; certified, so that it is the best of all sets."""
    from bcid.forms.simulate import recorded
    from bcid.search.identify import IdentifyOptions, identify

    scene: Scene = store.read()
    measurement = recorded(scene, condition.actions(), seen, 0.0, np.random.default_rng(0))
    measurement = replace(measurement, noise_sigma=condition.noise or None)
    began = time.process_time()
    found = identify(scene, measurement, options=IdentifyOptions(random_state=number, finest=condition.finest))
    seconds = time.process_time() - began
    right = frozenset(found.anchored) == condition.held(number)
    return {
        "found": sorted(found.anchored),
        "right": right,
        "best": sorted(found.anchored) if found.certified else [],
        "best_right": right and found.certified,
        "rms": found.rms,
        "calls": {str(level): count for level, count in found.evaluations.items()},
        "cpu_seconds": round(seconds, 3),
    }
