"""Make a measurement of a block that is cut out of a larger body: volume correlation, points 5 mm apart, noise of 0.01 mm.

./dev python examples/make_cut.py [FOLDER [RATIO]]

The larger body is 80 x 60 x 40 mm, glued at its bottom and sheared and pulled at its top; nothing of that is in the measurement.
RATIO is the stiffness of a ball inside of the block to that around it.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from bcid import Measurement, Scene
from bcid.forms.forward import Forward
from bcid.forms.simulate import recorded
from bcid.scene import Action, Grasp, Level, Region
from bcid.scene.parts import BodyRegion

HERE = Path(__file__).resolve().parent
RATIO = 5.0
NOISE = 0.01e-3
PULL = (0.006, 0.002, 0.004)
STEPS = 5
SEED = 3


def simulated(ratio: float = RATIO) -> Measurement:
    """The measurement of a block whose ball is so many times as stiff."""
    scene = Scene.read(HERE / "scenes/cut.toml")
    ball = {name: scene.parameters[name] for name in ("cx", "cy", "cz", "r")}
    larger = replace(
        scene,
        parameters={"x0": 0.0, "y0": 0.0, "z0": 0.0, "x1": 80.0, "y1": 60.0, "z1": 40.0, **ball},
        levels=(Level(2, 0.005),),
        regions={"ball": BodyRegion(volumes=("ball",), ratio=ratio)},
        patches={"bottom": Region(("bottom",))},
        grasps={"top": Grasp(Region(("top",)), (0.04, 0.03, 0.04))},
        places={},
        driven={},
    )
    part = np.linspace(0, 1, STEPS)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1))
    action = Action("1", np.arange(STEPS), np.arange(STEPS), "top", part[:, None] * PULL, still)
    forward = Forward(larger, 0)
    positions = forward.predict({"bottom"}, [action]).positions
    forward.destroy()
    alone = replace(action, grasp="", translation=np.zeros((STEPS, 3)))
    return recorded(
        scene, [alone], positions, NOISE, np.random.default_rng(SEED), action.clock, "a block cut out of a body"
    )


def main(folder: Path, ratio: float = RATIO) -> Measurement:
    """Write the measurement into a folder that does not exist yet."""
    made = simulated(ratio)
    made.write(folder)
    return made


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "measurements/cut-5", *map(float, sys.argv[2:3]))
