"""Make a measurement of a gel with a ball of foam: volume correlation, points inside of the block, noise of 0.02 mm.

./dev python examples/make_foam.py [FOLDER [POISSON]]

POISSON is Poisson's ratio of the ball; that of the gel is 0.45. The mesh is fitted to the ball, which that of the scene is not.
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
POISSON = 0.2
NOISE = 0.02e-3
PRESS = 0.004
STEPS = 5
SEED = 5


def simulated(poisson: float = POISSON) -> Measurement:
    """The measurement of a gel whose ball has this Poisson's ratio."""
    scene = Scene.read(HERE / "scenes/foam.toml")
    fitted = {"cx": 20.0, "cy": 20.0, "cz": 15.0, "r": 10.0}
    ball = {"ball": BodyRegion(volumes=("ball",), constants={"poisson": poisson})}
    true = replace(scene, parameters={**scene.parameters, **fitted}, levels=(Level(2, 0.005),), regions=ball)
    way = np.linspace(0, PRESS, STEPS)[:, None] * [0.0, 0.0, -1.0]
    still = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1))
    action = Action("1", np.arange(STEPS), np.arange(STEPS), "top", way, still)
    forward = Forward(true, 0)
    positions = forward.predict((), [action]).positions
    forward.destroy()
    return recorded(scene, [action], positions, NOISE, np.random.default_rng(SEED), action.clock, "a gel with foam")


def main(folder: Path, poisson: float = POISSON) -> Measurement:
    """Write the measurement into a folder that does not exist yet."""
    made = simulated(poisson)
    made.write(folder)
    return made


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "measurements/foam", *map(float, sys.argv[2:3]))
