"""
How stiff is it?
================

Pull a slab whose scene states the wrong Young's modulus, with a gripper that feels forces, and find anchors and stiffness together.

Positions alone tell only what stiffnesses are to each other. With the gripper's force (``wrench.csv``) the scene's constants
are believed to be right within ``stiffness`` of ``[uncertainty]``, 50 % unless said otherwise, and the answer tells them with an
interval that counts noise, gain and zero of the sensor, the mesh, and what else the scene may have slightly wrong. The body that
is pulled here is made of cubic elements, and is 27 % stiffer than its scene.

::

    ./dev python examples/08_forces.py
"""

from dataclasses import replace
from pathlib import Path

from bcid import IdentifyOptions, Scene, identify, motions, simulate
from bcid.base.units import uncertain
from bcid.forms.model import check_physics
from bcid.scene import Level

HERE = Path(__file__).resolve().parent
TRUE = 19e3


def main() -> tuple[float, float]:
    """Young's modulus and its standard error, Pa."""
    scene = Scene.read(HERE / "scenes" / "slab.toml", physics=check_physics)
    stiffer = replace(scene.material, values={**scene.material.values, "young": f"{TRUE} Pa"})
    body = replace(scene, levels=(Level(3, 0.016),), material=stiffer)
    pulls = motions.motion("pull", "III", 1, 0.012, 5, (0.6, 0.8, 0.0))
    measured = simulate(body, ["3", "4"], pulls, noise=0.2e-3, wrench=True, wrench_noise=0.02)
    found = identify(scene, measured, options=IdentifyOptions(level=2))
    assert found.stiffness is not None
    young = found.stiffness.constants["young"]
    assert young.stderr is not None
    value, error = young.value, young.stderr
    print(f"{found.headline}\nyoung = {uncertain(value, error, 'Pa')}; the body that was pulled has {TRUE:.0f} Pa")
    return value, error


if __name__ == "__main__":
    main()
