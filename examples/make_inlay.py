"""Make a measurement of the sheet with an inlay: image correlation of its front face, two coordinates, noise of 0.02 mm.

./dev python examples/make_inlay.py [FOLDER [RATIO]]

RATIO is the stiffness of the inlay to that of the sheet. The mesh is fitted to the inlay, which that of the scene is not.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from bcid import Measurement, Scene
from bcid.forms.forward import Forward
from bcid.forms.simulate import recorded
from bcid.scene import Action, Level
from bcid.scene.parts import BodyRegion

HERE = Path(__file__).resolve().parent
RATIO = 4.0
NOISE = 0.02e-3
PULL = 0.016
STEPS = 5
SEED = 4


def simulated(ratio: float) -> Measurement:
    """The measurement of a sheet whose inlay is so many times as stiff."""
    scene = Scene.read(HERE / "scenes/inlay.toml")
    fitted = {"inlay": BodyRegion(volumes=("inlay",), ratio=ratio)}
    true = replace(scene, parameters={"fitted": 1.0}, levels=(Level(2, 0.003),), regions=fitted)
    way = np.linspace(0, PULL, STEPS)[:, None] * [1.0, 0.0, 0.0]
    still = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1))
    action = Action("1", np.arange(STEPS), np.arange(STEPS), "jaw", way, still)
    forward = Forward(true, 0)
    positions = forward.predict((), [action]).positions
    forward.destroy()
    rng = np.random.default_rng(SEED)
    made = recorded(scene, [action], positions, NOISE, rng, action.clock, "a sheet with an inlay")
    made.data["position"][{"axis": 2}] = np.nan
    return made


def main(folder: Path, ratio: float = RATIO) -> Measurement:
    """Write the measurement into a folder that does not exist yet."""
    made = simulated(ratio)
    made.write(folder)
    return made


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "measurements/inlay-4", *map(float, sys.argv[2:3]))
