"""Which sets Algorithm 1 looks at: ``mpirun -n 2 python -m validation.bench.algorithm1_sets MEASUREMENT SEEDS COUNTED FINEST``.

The plain algorithm: from every seed to the best single toggle until none is better, each distinct set evaluated once, in full.
Where it goes depends only on which sets are better than the one it is at, so that here a neighbour's evaluation may end as soon as
it is worse; the path is the same. Two readings. One stage: all on the finest level, where the sets are counted with the misfits of
the level COUNTED, and the answer is what climbs on the finest level from the maxima so found end on. In stages: from the seeds on
level 0, from the maxima found there on level 1, and the best of those once on the finest.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np
from mpi4py import MPI

# One thread, before NumPy is loaded.
import validation.bench.peers.problem  # noqa: F401
from bcid.search.hill_climbing import Candidate, climb, random_seeds
from bcid.search.set_misfits import MeasuredMisfits
from validation.bench.bench_slab import encoded, measurement, scene


def stage(level: int, visited: Iterable[Candidate]) -> dict[str, Any]:
    """A stage as JSON."""
    return {"level": level, "visited": sorted(map(encoded, visited))}


def main() -> None:
    """Both readings."""
    name, *numbers = sys.argv[1:]
    count, counted, finest = map(int, numbers)
    model = MeasuredMisfits(scene(), measurement(name), MPI.COMM_WORLD)
    seeds = random_seeds(model.patches, count, np.random.default_rng(0))
    ends, whole = climb(model, counted, seeds)
    if finest > counted:
        ends, _ = climb(model, finest, ends)
    readings = {"one stage": {"stages": [stage(finest, whole)], "answer": encoded(ends[0])}}
    following: list[Candidate] = seeds
    stages = []
    for level in range(min(2, finest + 1)):
        following, visited = climb(model, level, following)
        stages.append(stage(level, visited))
    if finest > 1:
        stages.append(stage(finest, following[:1]))
    readings["in stages"] = {"stages": stages, "answer": encoded(following[0])}
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps({"readings": readings, "equivalents": model.evaluations()}), flush=True)
    model.destroy()


if __name__ == "__main__":
    main()
