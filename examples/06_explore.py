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

from bcid import ExploreOptions, Measurement, Scene, explore
from bcid.api.results import ExploreResult
from bcid.exploration.robots import Folder, Simulated
from bcid.measurement import Action
from bcid.predict.pull_predictor import PullPredictor

HERE = Path(__file__).resolve().parent
NOISE = 1e-3


def main(folder: Path, store: Path | None = None) -> ExploreResult:
    """Explore, with a lab that works in `folder`."""
    scene = Scene.read(HERE / "scenes/slab_explain.toml")
    # What is known need not be asked: below the patches 5 to 8 there is a gap, and this robot pulls in three directions.
    assert scene.limits is not None
    limits = replace(scene.limits, directions={"+x": (1, 0, 0), "+y": (0, 1, 0), "+z": (0, 0, 1)})
    scene = replace(scene, patches={name: scene.patches[name] for name in "1234"}, limits=limits)
    options = ExploreOptions(noise=NOISE, grasps=("II",))
    with Popen([sys.executable, __file__, "lab", folder]) as process:
        try:
            found = explore(scene, Folder(folder, scene, wait=120.0), MPI.COMM_WORLD, options, store)
        finally:
            process.terminate()
    print(found.to_dataframe().to_string(index=False))
    print(found.headline)
    return found


def lab(folder: Path) -> None:
    """What stands for robot and camera: make every pull that is asked for, and write what is seen."""
    scene = Scene.read(HERE / "scenes/slab_explain.toml")
    body = Simulated(PullPredictor(scene, len(scene.levels) - 1, MPI.COMM_SELF), "34", NOISE)
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
