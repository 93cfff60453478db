"""Make the measurement slab-34-heavy: a slab under its weight, seen with noise of 0.2 mm.

./dev python examples/make_slab_34_heavy.py [FOLDER]

The weight is in no scene file: the measurement is there to be explained. Cubic elements on a mesh of their own and half
steps keep the errors of a diagnosis from being those of the measurement.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from bcid import Measurement, Model, Scene
from bcid.forms.forward import Forward
from bcid.forms.model import Term
from bcid.forms.simulate import recorded
from bcid.forms.solver.equilibrium import Settings
from bcid.scene import Level
from validation.synthetic.truth import halved

HERE = Path(__file__).resolve().parent
ANCHORS = ("3", "4")
# N/m^3: a tenth of that of tissue, as of a body that nearly floats.
WEIGHT = 1260.0
NOISE = 0.2e-3
SEED = 34


def main(folder: Path) -> Measurement:
    """Write the measurement into a folder that does not exist yet."""
    scene = replace(Scene.read(HERE / "scenes/slab.toml"), levels=(Level(degree=3, element_size=0.014),))
    like = Measurement.read(HERE / "measurements/slab-27-five")
    forward = Forward(
        scene, 0, model=Model.of(scene) + Term("gravity", {"weight": WEIGHT}), settings=Settings(rtol=1e-8)
    )
    count = sum(len(action) for action in like.actions)
    actions, extra = [], count
    for action in like.actions:
        actions.append(halved(action, extra))
        extra += len(action) - 1
    positions = forward.predict(ANCHORS, actions).positions[:count]
    rng, times = np.random.default_rng(SEED), like.data["time"].values
    made = recorded(scene, like.actions, positions, NOISE, rng, times, "a slab under its weight")
    made.write(folder)
    return made


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "measurements/slab-34-heavy")
