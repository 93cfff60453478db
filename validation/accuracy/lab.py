"""Identify the four measurements of an independent code and print what it took.

    ./dev python -m validation.accuracy.lab
    ./dev mpirun -n 2 python -m validation.accuracy.lab
    ./dev python -m validation.accuracy.lab --no-exhaustive     only what the climbs come to

Their names say which patches are anchored.
"""

from __future__ import annotations

import sys
from pathlib import Path

from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.base.options import IdentifyOptions
from bcid.search.identify import identify

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
MEASUREMENTS = ("slab-12-semicircle", "slab-1234-semicircle", "slab-27-five", "slab-34-complex")
OPTIONS = IdentifyOptions(exhaustive="no" if "--no-exhaustive" in sys.argv else "auto")


def main() -> None:
    """Print the table on rank 0."""
    comm = MPI.COMM_WORLD
    scene = Scene.read(EXAMPLES / "scenes/slab.toml")
    columns = (
        "measurement",
        "anchored",
        "right",
        "probability",
        "certified",
        "residual",
        "trajectories per level",
        "time",
    )
    form = "{:<22} {:<9} {:<6} {:>12} {:<10} {:>9} {:>26} {:>8}"
    if comm.rank == 0:
        print(f"{comm.size} rank(s)\n{form.format(*columns)}", flush=True)
    for name in MEASUREMENTS:
        found = identify(scene, Measurement.read(EXAMPLES / "measurements" / name), comm, OPTIONS)
        if comm.rank > 0:
            continue
        right = "yes" if list(found.anchored) == list(name.split("-")[1]) else "NO"
        counts = " ".join(f"{level}: {count:.1f}" for level, count in found.evaluations.items())
        certified = "yes" if found.certified else "no"
        numbers = (f"{found.probability:.6f}", certified, f"{found.rms * 1e3:.3f} mm", counts, f"{found.seconds:.1f} s")
        row = form.format(name, " ".join(found.anchored), right, *numbers)
        print(row, flush=True)


if __name__ == "__main__":
    main()
