"""
Explore through a folder
========================

Explore how a slab is held through a folder, as with a real robot: bcid asks for pulls, a lab in a process of its own makes them.

::

    ./dev python examples/06_explore.py
"""

import csv
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from subprocess import Popen

import numpy as np
from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.explore.loop import Exploration, Plan, explore, paired
from bcid.explore.predictions import Predictor
from bcid.explore.robots import Folder, Simulated
from bcid.measurement import Action

HERE = Path(__file__).resolve().parent
NOISE = 1e-3


def main(folder: Path, store: Path | None = None) -> Exploration:
    """Explore, with a lab that works in `folder`."""
    scene = Scene.read(HERE / "scenes/slab_explain.toml")
    # What is known need not be asked: below the patches 5 to 8 there is a gap, and this robot pulls in three directions.
    assert scene.limits is not None
    limits = replace(scene.limits, directions={"+x": (1, 0, 0), "+y": (0, 1, 0), "+z": (0, 0, 1)})
    scene = replace(scene, patches={name: scene.patches[name] for name in "1234"}, limits=limits)
    ladder = paired(scene, None, MPI.COMM_WORLD)
    predictors = [Predictor(ladder, level, MPI.COMM_WORLD, store) for level in range(2)]
    with Popen([sys.executable, __file__, "lab", folder]) as process:
        try:
            found = explore(scene, Folder(folder, scene, wait=120.0), Plan(noise=NOISE, grasps=("II",)), *predictors)
        finally:
            process.terminate()
    for step in found.steps:
        print(f"{step.move}: {step.expected[0]:.2f} bits expected, {step.gained:.2f} gained")
    print(f"{found.reason}: {' '.join(sorted(found.view.best.anchors))}, probability {found.view.certainty:.4f}")
    for predictor in predictors:
        predictor.destroy()
    return found


def lab(folder: Path) -> None:
    """What stands for robot and camera: make every pull that is asked for, and write what is seen."""
    scene = Scene.read(HERE / "scenes/slab_explain.toml")
    body = Simulated(Predictor(scene, len(scene.levels) - 1, MPI.COMM_SELF), "34", NOISE)
    while True:
        for asked in sorted(folder.glob("*/wanted.csv")):
            place = asked.parent / "measurement"
            if not place.exists():
                body.move(wanted(asked))
                seen: Measurement = body.observe()
                seen.write(place)
        time.sleep(0.1)


def wanted(file: Path) -> Action:
    """The pull that a file asks for, in mm and s."""
    rows = list(csv.DictReader(file.read_text(encoding="utf-8").splitlines()))
    numbers = np.array([[float(row[key]) for key in ("x", "y", "z", "qw", "qx", "qy", "qz", "time")] for row in rows])
    steps = np.arange(len(rows))
    return Action(
        rows[0]["action"], steps, steps, rows[0]["grasp"], numbers[:, :3] * 1e-3, numbers[:, 3:7], times=numbers[:, 7]
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["lab"]:
        lab(Path(sys.argv[2]))
    else:
        with tempfile.TemporaryDirectory() as made:
            main(Path(made))
