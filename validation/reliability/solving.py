"""L1: random anchor sets and pulls to 30 mm; L2: memory over thousands of candidate trajectories in one process."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid import Scene
from bcid.forms.forward import Forward
from bcid.forms.solver.status import Status
from bcid.measurement import Action
from validation.reliability import SLAB, Reached

Array = NDArray[np.float64]
_SHARE = 0.995
_STEPS = 15
_FAR = 0.030
_GROWTH = 10.0
# Memory is compared with that after so many trajectories.
_SETTLED = 100


def pull(direction: Array, amplitude: float, steps: int, grasp: str) -> Action:
    """A straight pull along `direction`, to `amplitude` m, in so many steps."""
    way = np.arange(steps + 1)[:, None] / steps * amplitude * direction
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (steps + 1, 1))
    return Action("pull", np.arange(steps + 1), np.arange(steps + 1), grasp, way, turn)


def candidates(scene: Scene, seed: int) -> Iterator[tuple[frozenset[str], Action]]:
    """Anchor sets that are not empty, each with a pull of 30 mm in any direction at any grasp, without end."""
    rng = np.random.default_rng(seed)
    patches, grasps = list(scene.patches), list(scene.grasps)
    while True:
        chosen = rng.random(len(patches)) < rng.uniform(0.1, 0.9)
        direction = rng.normal(size=3)
        grasp = grasps[rng.integers(len(grasps))]
        if chosen.any():
            anchors = frozenset(name for name, taken in zip(patches, chosen, strict=True) if taken)
            yield anchors, pull(direction / np.linalg.norm(direction), _FAR, _STEPS, grasp)


def crushed(forward: Forward, anchors: frozenset[str], action: Action) -> bool:
    """Whether a tetrahedron with all its nodes on the gripper and on anchored patches is turned inside out at a step.

    Where its nodes go is prescribed: there is no equilibrium on this mesh, whatever the rest of the body does.
    """
    mesh, scene = forward.mesh, forward.scene
    held, gripped = (np.zeros(len(mesh.points), dtype=bool) for _ in range(2))
    for name in anchors:
        held[mesh.select(scene.patches[name], f"patch {name}")] = True
    gripped[mesh.select(scene.grasps[action.grasp].region, f"grasp {action.grasp}")] = True
    corners = mesh.cells[:, :4]
    rigid = corners[(held | gripped)[corners].all(axis=1)]
    moved = mesh.points[rigid] + action.translation[:, None, None, :] * gripped[rigid][..., None]
    volumes = np.linalg.det(moved[:, :, 1:] - moved[:, :, :1])
    return bool((volumes * np.sign(volumes[:1]) <= 0).any())


def convergence(count: int = 2000, seed: int = 0, level: int = 1) -> Reached:
    """L1: how many candidates converge on a level, of those for which the mesh leaves room for an equilibrium."""
    scene = Scene.read(SLAB)
    forward = Forward(scene, level)
    statuses: Counter[str] = Counter()
    impossible, good, halved, tried = 0, 0, 0, 0
    for anchors, action in candidates(scene, seed):
        if tried == count:
            break
        prediction = forward.predict(anchors, [action])
        trajectory = prediction.trajectories[0]
        converged = trajectory.status is Status.CONVERGED
        if converged != prediction.complete or (not converged and not trajectory.reason):
            raise AssertionError(f"{sorted(anchors)}: {trajectory}, complete: {prediction.complete}")
        if crushed(forward, anchors, action):
            if converged:
                raise AssertionError(f"{sorted(anchors)}: converged with an element turned inside out")
            impossible += 1
            continue
        tried, good = tried + 1, good + converged
        statuses[str(trajectory.status)] += 1
        halved += converged and trajectory.halvings > 0
    forward.destroy()
    parts = ", ".join(f"{status} {n}" for status, n in statuses.most_common())
    text = f"level {level}: {good} of {count} ({good / count:.2%}; {parts}), {halved} with halved steps; "
    text += f"{impossible} more were drawn for which there is no equilibrium, each with a status"
    goal = "99.5 % of 2,000 for which there can be an equilibrium converge with at most 5 halvings of a step"
    return Reached(goal, text, good >= _SHARE * count)


def resident() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def memory(count: int = 5000, seed: int = 0, settled: int = _SETTLED, far: int = 10) -> Reached:
    """L2: growth of resident memory after the first `settled` trajectories; every `far`-th goes to 30 mm, where many fail."""
    scene = Scene.read(SLAB)
    forward = Forward(scene, 1)
    rng = np.random.default_rng(seed)
    before, failed, marks = 0.0, 0, []
    for number, (anchors, action) in zip(range(1, count + 1), candidates(scene, seed), strict=False):
        short = pull(action.translation[-1] / _FAR, _FAR if number % far == 0 else 0.004, 2, action.grasp)
        prediction = forward.predict(anchors, [short], keep=bool(rng.random() < 0.5))
        failed += prediction.failure is not None
        if number == settled:
            before = resident()
        if number % max(count // 5, 1) == 0:
            marks.append(f"{number}: {resident():.1f}")
    grown = resident() - before
    forward.destroy()
    text = f"{grown:+.1f} MB from trajectory {settled} to {count} ({failed} of them failed); MB at {', '.join(marks)}"
    return Reached("resident memory grows by at most 10 MB after the 100th trajectory", text, grown <= _GROWTH)
