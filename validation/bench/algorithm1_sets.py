"""Which sets Algorithm 1 looks at: ``mpirun -n 2 python -m validation.bench.algorithm1_sets MEASUREMENT SEEDS COUNTED FINEST``.

The plain algorithm: from every seed to the best single toggle until none is better, each distinct set evaluated once, in full.
Where it goes depends only on which sets are better than the one it is at, so that here a neighbour's evaluation may end as soon as
it is worse; the path is the same. Two readings. One stage: all on the finest level, where the sets are counted with the misfits of
the level COUNTED, and the answer is what climbs on the finest level from the maxima so found end on. In stages: from the seeds on
level 0, from the maxima found there on level 1, and the best of those once on the finest.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np
from mpi4py import MPI

# One thread, before NumPy is loaded.
import validation.bench.peers.problem  # noqa: F401
from bcid.inference.outcome import Candidate, Outcome
from bcid.search.climb import neighbours, rank
from bcid.search.evaluator import Evaluator
from bcid.search.seeds import random_seeds
from validation.bench.bench_slab import encoded, measurement, scene


def climb(evaluator: Evaluator, level: int, seeds: Iterable[Candidate]) -> tuple[set[Candidate], list[Outcome]]:
    """Climb from every seed; all sets that were looked at, and the outcomes climbs ended on, best first. Collective."""
    here = {seed: seed for seed in seeds}
    visited = set(here)
    evaluator.evaluate(level, dict.fromkeys(here, math.inf))
    active = list(here)
    while active:
        bounds: dict[Candidate, float] = {}
        for seed in active:
            parent = evaluator.outcomes[level, here[seed]]
            for candidate in neighbours(here[seed], evaluator.patches):
                bounds[candidate] = max(bounds.get(candidate, 0.0), parent.chi2)
        visited |= set(bounds)
        found = evaluator.evaluate(level, bounds)
        moved = []
        for seed in active:
            parent = evaluator.outcomes[level, here[seed]]
            best = min((found[c] for c in neighbours(here[seed], evaluator.patches)), key=rank)
            if rank(best) < rank(parent):
                here[seed] = best.candidate
                moved.append(seed)
        active = moved
    return visited, sorted((evaluator.outcomes[level, top] for top in set(here.values())), key=rank)


def stage(level: int, visited: Iterable[Candidate]) -> dict[str, Any]:
    """A stage as JSON."""
    return {"level": level, "visited": sorted(map(encoded, visited))}


def main() -> None:
    """Both readings."""
    name, *numbers = sys.argv[1:]
    count, counted, finest = map(int, numbers)
    evaluator = Evaluator(scene(), measurement(name), MPI.COMM_WORLD)
    seeds = random_seeds(evaluator.patches, count, np.random.default_rng(0))
    whole, ends = climb(evaluator, counted, seeds)
    if finest > counted:
        _, ends = climb(evaluator, finest, [outcome.candidate for outcome in ends])
    readings = {"one stage": {"stages": [stage(finest, whole)], "answer": encoded(ends[0].candidate)}}
    following: list[Candidate] = seeds
    stages = []
    for level in range(min(2, finest + 1)):
        visited, ends = climb(evaluator, level, following)
        stages.append(stage(level, visited))
        following = [outcome.candidate for outcome in ends]
    if finest > 1:
        stages.append(stage(finest, following[:1]))
    readings["in stages"] = {"stages": stages, "answer": encoded(following[0])}
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps({"readings": readings, "equivalents": evaluator.evaluations()}), flush=True)
    evaluator.destroy()


if __name__ == "__main__":
    main()
