"""bcid explores the slab as in the README: ``python -m validation.bench.bcid_explore FOLDER [GRASP BUDGET]``."""

from __future__ import annotations

from validation.bench.peers.problem import Clock, memory

# isort: split
import json
import sys
from pathlib import Path

from mpi4py import MPI

import bcid
from bcid.base.options import ExploreOptions
from bcid.base.run_folder import RunFolder
from bcid.base.shipped import shipped
from bcid.exploration.explore_run import run_exploration
from validation.bench.bench_slab import EXPLAINED

ROBOT, NOISE, RANDOM_STATE = "simulated:1,2", 4e-3, 1
TOLD = ("reason", "anchored", "probability")


def main() -> None:
    """Explore it, as the command does without pictures."""
    folder, *less = sys.argv[1:]
    options = ExploreOptions(noise=NOISE, seed=RANDOM_STATE)
    if less:
        options = ExploreOptions(noise=NOISE, seed=RANDOM_STATE, grasps=(less[0],), budget=float(less[1]))
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    clock.start()
    place = run_exploration(shipped(EXPLAINED), ROBOT, Path(folder), options, MPI.COMM_WORLD, overwrite=True)
    clock.stop()
    run = RunFolder.open(place)
    found = run.read_json("exploration.json")
    told = {key: found[key] for key in TOLD} | {"pulls": len(found["steps"]), "rss_mb": memory()}
    told |= {key: run.record[key] for key in ("evaluations", "tangents")}
    print(json.dumps(clock.record | told), flush=True)


if __name__ == "__main__":
    main()
