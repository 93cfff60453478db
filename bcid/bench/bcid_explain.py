"""bcid explains a shipped measurement of the slab: ``python -m bcid.bench.bcid_explain MEASUREMENT FOLDER``."""

from __future__ import annotations

from bcid.bench.peers.problem import Clock, memory

# isort: split
import json
import sys
from pathlib import Path

from mpi4py import MPI

import bcid
from bcid.base.run_folder import RunFolder
from bcid.base.shipped import shipped
from bcid.bench.bench_slab import EXPLAINED, FOLDER
from bcid.comparison.compare_runs import run_explain

TOLD = ("verdict", "verdict_probability", "anchored", "anchors_probability", "rms", "noise_rms")


def main() -> None:
    """Explain it, as the command does without pictures."""
    name, folder = sys.argv[1:]
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    clock.start()
    scene, measurement = shipped(EXPLAINED), shipped(FOLDER) / name
    run = RunFolder.open(run_explain(scene, measurement, Path(folder), None, MPI.COMM_WORLD, overwrite=True))
    clock.stop()
    found = run.read_json("diagnosis.json")
    told = {key: found[key] for key in TOLD} | {"trajectories": run.record["trajectories"], "rss_mb": memory()}
    print(json.dumps(clock.record | told), flush=True)


if __name__ == "__main__":
    main()
