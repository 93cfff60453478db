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
from bcid.forms.solve import Status
from bcid.measurement import Action
from benchmarks.reliability import SLAB, Reached

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


def convergence(count: int = 2000, seed: int = 0, levels: tuple[int, ...] = (0, 1)) -> Reached:
    """L1: how many of the candidates converge; half of them on each of the levels."""
    scene = Scene.read(SLAB)
    statuses: Counter[tuple[int, str]] = Counter()
    halved = 0
    for level in levels:
        forward = Forward(scene, level)
        for _, (anchors, action) in zip(range(count // len(levels)), candidates(scene, seed + level), strict=False):
            prediction = forward.predict(anchors, [action])
            trajectory = prediction.trajectories[0]
            status = trajectory.status
            if status is Status.CONVERGED and not prediction.complete:
                raise AssertionError(f"{sorted(anchors)}: converged without all its frames")
            halved += status is Status.CONVERGED and trajectory.halvings > 0
            statuses[level, str(status)] += 1
        forward.destroy()
    total = statuses.total()
    good = sum(n for (_, status), n in statuses.items() if status == Status.CONVERGED)
    parts = [f"level {level}: {status} {n}" for (level, status), n in sorted(statuses.items())]
    text = f"{good} of {total} ({good / total:.2%}), {halved} of them with halved steps; {', '.join(parts)}"
    return Reached("99.5 % of 2,000 converge with at most 5 halvings of a step", text, good >= _SHARE * total)


def resident() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def memory(count: int = 5000, seed: int = 0, settled: int = _SETTLED) -> Reached:
    """L2: growth of resident memory after the first `settled` trajectories, failed ones among them."""
    scene = Scene.read(SLAB)
    forward = Forward(scene, 1)
    rng = np.random.default_rng(seed)
    before, failed, marks = 0.0, 0, []
    for number, (anchors, action) in zip(range(1, count + 1), candidates(scene, seed), strict=False):
        short = pull(action.translation[-1] / _FAR, _FAR if number % 10 == 0 else 0.004, 2, action.grasp)
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
