"""What every script that computes one trajectory shares: the problem, and the record it prints. Units mm, kPa (forces mN).

Each is run as ``-m validation.bench.peers.NAME MESH FIELD``: MESH is small, medium or large, FIELD the .npy file that takes the
final displacement of every node (mm). The last line printed is a record in JSON.
"""

from __future__ import annotations

import time

# Set-up counts from here: importing what a program is made of is part of starting it.
_BEGIN = time.perf_counter()

import json  # noqa: E402
import os  # noqa: E402
import resource  # noqa: E402
import sys  # noqa: E402
from typing import Any  # noqa: E402

for _name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR"):
    os.environ.setdefault(f"{_name}_NUM_THREADS", "1")

import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from bcid.base.shipped import shipped  # noqa: E402

YOUNG, POISSON = 15.0, 0.35
MU = YOUNG / 2 / (1 + POISSON)
LAM = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON)
RTOL = 1e-8
MOST_ITERATIONS = 25
LEG = 20
"""Steps of each of the two legs of the motion."""

PLACES = [np.array([10.0 * k / LEG, 0.0, 0.0]) for k in range(1, LEG + 1)]
PLACES += [np.array([10.0, 0.0, 10.0 * k / LEG]) for k in range(1, LEG + 1)]
"""Where the gripper is after each step, mm."""

Array = NDArray[np.float64]


def problem(mesh: str) -> dict[str, NDArray[Any]]:
    """Arrays of a mesh: points (mm), cells, nodes `fixed` and `patch`, and `field`, the answer (mm)."""
    with np.load(shipped(f"tests/data/slab40-{mesh}.npz"), allow_pickle=False) as data:
        arrays = dict(data)
    return arrays | {name: arrays[name].astype(np.int64) for name in ("cells", "fixed", "patch")}


def arguments() -> tuple[str, str]:
    """MESH and FIELD of the command line."""
    mesh, field = sys.argv[1:3]
    return mesh, field


def memory() -> float:
    """Largest resident memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


class Clock:
    """Times one trajectory: set-up until `start`, the trajectory until `stop`."""

    def __init__(self, tool: str, version: str) -> None:
        self.record: dict[str, Any] = {"tool": tool, "version": version}
        self.iterations: list[int] = []

    def start(self) -> None:
        """The set-up is done."""
        self._wall, self._cpu = time.perf_counter(), time.process_time()
        self.record["setup_s"] = self._wall - _BEGIN

    def step(self, iterations: int) -> None:
        """A step is done, with so many Newton iterations."""
        self.iterations.append(int(iterations))

    def stop(self) -> None:
        """The trajectory is done."""
        self.record["wall_s"] = time.perf_counter() - self._wall
        self.record["cpu_s"] = time.process_time() - self._cpu
        self.record |= {"steps": len(self.iterations), "iterations": sum(self.iterations), "rss_mb": memory()}

    def finish(self, field: str, displacement: Array, **more: Any) -> None:
        """Save the displacement (nodes, 3), mm, and print the record."""
        np.save(field, displacement)
        print(json.dumps(self.record | more), flush=True)


def in_order(points: Array, where: Array, values: Array) -> Array:
    """`values` that stand at the points `where`, in the order of `points`; all of shape (nodes, 3)."""
    from scipy.spatial import cKDTree

    distance, order = cKDTree(where).query(points)
    assert distance.max() < 1e-9
    return np.asarray(values[order])
