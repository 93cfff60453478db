"""Which linear solver is fastest for a body: CHOLMOD, MUMPS, or conjugate gradients with multigrid?

    ./dev python benchmarks/linear_solvers.py [ELEMENT_SIZE_MM,DEGREE ...]

Pulls the benchmark slab (patches 3 and 4 anchored) by three steps of 2 mm with each solver, in one run, and prints the time per
factorisation and the ratios to CHOLMOD; the displacements must agree. Without arguments: 20,1 20,2 7.2,1 7.2,2 3.6,1. The size
above which bcid takes multigrid (`Settings.direct_up_to`) was read off 1.15,1 (180,000 unknowns; takes two minutes).
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

from bcid import Scene
from bcid.forms.forward import Forward
from bcid.forms.mesh import level_mesh
from bcid.forms.solver.equilibrium import Settings
from bcid.scene import Level
from bcid.scene.motions import actions, pull

SCENE = Path(__file__).resolve().parents[1] / "examples/scenes/slab.toml"
REPEATS = 3


def measure(scene: Scene, solver: str) -> tuple[float, np.ndarray, int]:
    """Median seconds of a pull, the fiducials' positions and the number of unknowns."""
    forward = Forward(
        scene,
        settings=Settings(linear="gamg" if solver == "gamg" else "direct"),
        mesh=level_mesh(scene, scene.levels[0]),
    )
    if solver == "mumps":
        forward.equilibrium.factor._definite = False
    motion = actions([(points[:4], turns[:4]) for points, turns in pull()], "II")
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        prediction = forward.predict(["3", "4"], motion)
        seconds.append(time.perf_counter() - start)
    unknowns = forward.body.unknowns
    forward.destroy()
    return float(np.median(seconds)), prediction.positions, unknowns


def main() -> None:
    """Print the table."""
    wanted = sys.argv[1:] or ["20,1", "20,2", "7.2,1", "7.2,2", "3.6,1"]
    slab = Scene.read(SCENE)
    print(
        f"{'size, degree':>14} {'unknowns':>9} {'cholmod':>9} {'mumps/cholmod':>14} {'gamg/cholmod':>13} {'difference':>11}"
    )
    for text in wanted:
        size, degree = text.split(",")
        scene = dataclasses.replace(slab, levels=(Level(int(degree), float(size) * 1e-3),))
        direct, positions, unknowns = measure(scene, "cholmod")
        others = [measure(scene, solver) for solver in ("mumps", "gamg")]
        difference = max(float(np.abs(p - positions).max()) for _, p, _ in others) / float(np.abs(positions).max())
        ratios = [seconds / direct for seconds, _, _ in others]
        print(
            f"{text:>14} {unknowns:>9} {direct:>8.3f}s {ratios[0]:>14.2f} {ratios[1]:>13.2f} {difference:>11.1e}",
            flush=True,
        )


if __name__ == "__main__":
    main()
