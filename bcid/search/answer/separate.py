"""Which pull would tell two explanations apart: all grasps of the scene in six directions, predicted by both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bcid.forms.forward import Forward
from bcid.measurement import Action
from bcid.results.diagnosis_record import SeparatingPull
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
_DIRECTIONS = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
_STEPS = 4


def separating_pulls(one: State, other: State, distance: float | None = None) -> list[SeparatingPull]:
    """Pulls of all grasps along the axes, the most telling first; collective.

    Args:
        one, other: the explanations, on the same predictor.
        distance: of the gripper, m; by default the longest of the measured actions, at most 12 mm.
    """
    predictor = one.predictor
    longest = max((float(np.linalg.norm(a.translation, axis=1).max()) for a in predictor.actions), default=0.0)
    distance = distance or min(longest or 0.01, 0.012)
    # How measured points would drive a place in another pull is not known.
    grasps = () if predictor.scene.driven else predictor.scene.grasps
    tasks = [(grasp, name) for grasp in grasps for name in _DIRECTIONS]
    found = []
    first, second = (_predictions(state, tasks, distance) for state in (one, other))
    for (grasp, name), a, b in zip(tasks, first, second, strict=True):
        if a is None or b is None:
            continue
        sigmas = float(np.sqrt(np.sum((a - b) ** 2)) / one.noise)
        found.append(SeparatingPull(grasp=grasp, direction=name, distance=distance, sigmas=sigmas))
    return sorted(found, key=lambda pull: -pull.sigmas)


def _predictions(state: State, tasks: Sequence[tuple[str, str]], distance: float) -> list[Array | None]:
    predictor = state.predictor
    forward = predictor.forward(state.model)
    mine: dict[int, Array | None] = {}
    for i, (grasp, name) in enumerate(tasks):
        if i % predictor.comm.size == predictor.comm.rank:
            mine[i] = _one(forward, state, grasp, np.array(_DIRECTIONS[name], float) * distance)
    together: dict[int, Array | None] = {}
    for part in predictor.comm.allgather(mine):
        together |= part
    return [together[i] for i in range(len(tasks))]


def _one(forward: Forward, state: State, grasp: str, way: Array) -> Array | None:
    steps = np.arange(_STEPS + 1)
    unturned = np.tile([1.0, 0.0, 0.0, 0.0], (len(steps), 1))
    action = Action("1", steps, steps, grasp, steps[:, None] / _STEPS * way, unturned)
    prediction = forward.predict(state.anchors, [action])
    if prediction.failure:
        return None
    frames = (forward.frame(action, step) for step in range(len(steps)))
    return np.array([state.model.observed(p, f) for p, f in zip(prediction.positions, frames, strict=True)])
