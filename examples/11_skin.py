"""
Skin between two pads
=====================

What holds skin that is stretched on an arm, how stiff it is, and what a model of a sheet does not know of it.

The measurement was published by Elouneg et al. (2021; github.com/aflahelouneg/inverse_identification_soft_tissue, MIT): an
extensometer with two pads glued to the skin, one of which is moved; image correlation of the skin between them, of which x and
y are seen; the force of the moving pad along x. The skin goes on beyond what is modelled: is its rim held there, or free? Its
thickness is not known, and neither is Poisson's ratio: the scene says so, and every answer is given for several guesses.

::

    ./dev python examples/11_skin.py FOLDER [healthy|keloid] -o skin

FOLDER holds healthy/ and keloid/, and beside each a scene file in which the points are.
"""

import argparse
import tomllib
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from bcid import Measurement, Scene, identify
from bcid.base.units import percent
from bcid.forms.model import check_physics

HERE = Path(__file__).resolve().parent
# Guesses: of the thickness, mm, and of Poisson's ratio; and how far a guess may be off, as standard deviations.
THICKNESSES, POISSONS = (1.0, 2.0), (0.2, 0.45)
UNSURE = {"thickness": 0.3, "poisson": 0.12}
# Every how many frames one is compared.
EVERY = 2
# What the authors found for Young's modulus times the thickness, N/mm, with a free rim.
PUBLISHED = {"healthy": (0.0265, 0.0311), "keloid": (0.0692, 0.1242)}
SCENE = """format = "bcid-scene/1"
name = "{specimen} skin"
description = "a patch of skin of 100 x 50 mm between two pads, {thickness:g} mm thick (a guess)"
down = [0, 0, -1]
noise_sigma = "0.015 mm"

[geometry]
file = "{geometry}"
length_unit = "mm"
parameters = {{ T = {thickness:g}, XA = {moving:g}, XB = {fixed:g} }}

[[levels]]
element_size = "9 mm"
degree = 2

[[levels]]
element_size = "5 mm"
degree = 2

[material]
law = "neo_hooke"
young = "30 kPa"
poisson = {poisson:g}

# The skin does not leave its plane, and one pad is glued to what does not move.
[held]
pad = "fixed"
plane = {{ on = "under", along = "z" }}

[patches]
rim = "rim"

[grasps]
mov = {{ on = "moving", centre = "{moving:g} 20 0 mm" }}

[uncertainty]
markers = "0.05 mm"
dimensions = {unsure[thickness]:g}
poisson = {unsure[poisson]:g}

[fiducials]
{points}
"""


@dataclass(frozen=True)
class Answer:
    """Of one guess.

    Attributes:
        thickness: mm.
        poisson: Poisson's ratio.
        rim: probability that the rim is held.
        missing: probability that something is missing in the model.
        rms: residual, mm.
        product: Young's modulus times the thickness, N/mm: the value, and the ends of its 95 % interval.
    """

    thickness: float
    poisson: float
    rim: float
    missing: float
    rms: float
    product: tuple[float, float, float]


def scene_text(folder: Path, specimen: str, thickness: float, poisson: float) -> str:
    """The scene file of a guess."""
    known = tomllib.loads((folder / f"{specimen}_scene.toml").read_text(encoding="utf-8"))
    pads = known["geometry"]["parameters"]
    points = (f'{name} = "{place}"' for name, place in known["fiducials"].items())
    return SCENE.format(
        specimen=specimen,
        geometry=HERE.parent / "meshes/geo/skin.geo",
        thickness=thickness,
        poisson=poisson,
        moving=pads["XA"],
        fixed=pads["XB"],
        unsure=UNSURE,
        points="\n".join(points),
    )


def seen(folder: Path, specimen: str, every: int = EVERY) -> Measurement:
    """The measurement: x and y of the points, and the force along x; the rest was not measured."""
    found = Measurement.read(folder / specimen)
    data = found.data.isel(frame=slice(None, None, every)).copy(deep=True)
    data["position"][{"axis": 2}] = np.nan
    data["wrench"][..., 1:] = np.nan
    # A third coordinate that nobody saw is no coordinate with a large error.
    data = data.drop_vars("sigma")
    return replace(found, data=data.assign_coords(step=("frame", np.arange(data.sizes["frame"]))))


def answer(folder: Path, specimen: str, thickness: float, poisson: float, work: Path, every: int = EVERY) -> Answer:
    """What is found with one guess; `work` takes the scene file."""
    work.mkdir(parents=True, exist_ok=True)
    file = work / f"{specimen}-{thickness:g}-{poisson:g}.toml"
    file.write_text(scene_text(folder, specimen, thickness, poisson), encoding="utf-8")
    scene = Scene.read(file, physics=check_physics)
    found = identify(scene, seen(folder, specimen, every))
    assert found.stiffness is not None
    assert found.discrepancy_probability is not None
    young = found.stiffness.constants["young"]
    assert young.interval is not None
    product = thickness * 1e-6 * np.array([young.value, *young.interval])
    return Answer(
        thickness,
        poisson,
        found.patches["rim"],
        found.discrepancy_probability,
        found.rms * 1e3,
        (product[0], product[1], product[2]),
    )


def main(folder: Path, specimen: str, work: Path, every: int = EVERY) -> list[Answer]:
    """The answers of all guesses, printed."""
    low, high = PUBLISHED[specimen]
    print(f"{specimen}: published, with a free rim: E t = {low:g} to {high:g} N/mm")
    found = []
    for thickness, poisson in product(THICKNESSES, POISSONS):
        one = answer(folder, specimen, thickness, poisson, work, every)
        value, least, most = one.product
        print(
            f"  t = {thickness:g} mm, nu = {poisson:g}: rim held {100 * one.rim:.0f} %, something missing {percent(one.missing)}, "
            f"residual {one.rms:.3f} mm, E t = {value:.3f} ({least:.3f} to {most:.3f}) N/mm",
            flush=True,
        )
        found.append(one)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("specimen", nargs="?", choices=list(PUBLISHED), default="healthy")
    parser.add_argument("-o", "--output", type=Path, default=Path("skin"), help="takes the scene files")
    given = parser.parse_args()
    main(given.folder, given.specimen, given.output)
