"""Identify the four shipped measurements and print what it took.

    ./dev python benchmarks/lab.py
    ./dev mpirun -n 2 python benchmarks/lab.py
    ./dev python benchmarks/lab.py --certify     every set of patches on the second and third level (minutes each)

The measurements were made by an independent code; their names say which patches are anchored.
"""

from __future__ import annotations

import sys
from pathlib import Path

from mpi4py import MPI

from bcid import Measurement, Scene, identify
from bcid.search.identify import Options

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
OPTIONS = Options(method="enumerate", coarsest=1, finest=2) if "--certify" in sys.argv else Options()


def main() -> None:
    """Print the table on rank 0."""
    comm = MPI.COMM_WORLD
    scene = Scene.read(EXAMPLES / "scenes/slab.toml")
    head = f"{'measurement':<22} {'anchored':<9} {'right':<6} {'certified':<10} {'residual':>9} {'trajectories per level':>24}"
    if comm.rank == 0:
        print(f"{comm.size} rank(s)\n{head} {'time':>8}", flush=True)
    for folder in sorted((EXAMPLES / "measurements").glob("slab-*")):
        found = identify(scene, Measurement.read(folder), comm, OPTIONS)
        if comm.rank > 0:
            continue
        right = list(found.anchored) == list(folder.name.split("-")[1])
        counts = " ".join(f"{level}: {count:.1f}" for level, count in found.evaluations.items())
        row = f"{folder.name:<22} {' '.join(found.anchored):<9} {'yes' if right else 'NO':<6}"
        row += (
            f" {'yes' if found.certified else 'no':<10} {found.rms * 1e3:>6.3f} mm {counts:>24} {found.seconds:>6.1f} s"
        )
        print(row, flush=True)


if __name__ == "__main__":
    main()
