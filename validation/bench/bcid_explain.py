"""bcid explains a shipped measurement of the slab: ``-m validation.bench.bcid_explain MEASUREMENT FOLDER [profile] [quick]``."""

from __future__ import annotations

from validation.bench.peers.problem import Clock, memory

# isort: split
import cProfile
import json
import sys
from pathlib import Path

from mpi4py import MPI

import bcid
from bcid.base.options import ExplainOptions
from bcid.base.run_folder import RunFolder
from bcid.base.shipped import shipped
from validation.bench.bench_slab import EXPLAINED, FOLDER
from validation.explained import run_explain

TOLD = ("verdict", "verdict_probability", "anchored", "anchors_probability", "rms", "noise_rms")
# The effects that the reduced form looks for.
FEW = ("gravity", "fibres", "grasp_slip")
SPENT = {
    "assembling matrices": ("assemble_matrix",),
    "assembling vectors": ("assemble_vector", "assemble_scalar"),
    "factorising": ("'setUp' of",),
    "triangular solves": ("'apply' of", "'matSolve' of"),
    "dense algebra": ("numpy.linalg", "einsum", "_linalg.py", "lapack", "_logsumexp"),
    "compiled forms": ("ufl/", "ffcx/", "jit.py", "'poll' of"),
}
"""What functions in which the time goes have in their names; the rest is Python and NumPy."""


def spent(profile: cProfile.Profile) -> dict[str, float]:
    """Shares of the time by kind of work."""
    found = dict.fromkeys([*SPENT, "the rest"], 0.0)
    for entry in profile.getstats():
        name = entry.code if isinstance(entry.code, str) else f"{entry.code.co_filename} {entry.code.co_name}"
        kind = next((kind for kind, words in SPENT.items() if any(word in name for word in words)), "the rest")
        found[kind] += entry.inlinetime
    whole = sum(found.values())
    return {kind: seconds / whole for kind, seconds in found.items()}


def main() -> None:
    """Explain it, as the command does without pictures."""
    name, folder, *also = sys.argv[1:]
    clock, profile = Clock("bcid", f"bcid {bcid.__version__}"), cProfile.Profile()
    options = ExplainOptions(level=0, max_effects=1, fitted=3, sets=12, only=FEW) if "quick" in also else None
    if "profile" in also:
        profile.enable()
    clock.start()
    scene, measurement = shipped(EXPLAINED), shipped(FOLDER) / name
    run = RunFolder.open(run_explain(scene, measurement, Path(folder), options, MPI.COMM_WORLD, overwrite=True))
    clock.stop()
    profile.disable()
    found = run.read_json("diagnosis.json")
    told = {key: found[key] for key in TOLD} | {"trajectories": run.record["trajectories"], "rss_mb": memory()}
    print(json.dumps(clock.record | told | ({"spent": spent(profile)} if "profile" in also else {})), flush=True)


if __name__ == "__main__":
    main()
