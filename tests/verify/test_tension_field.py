"""Sheets that wrinkle, against closed forms of membranes, and what an answer is without the line that says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from bcid import Measurement, Scene, identify
from bcid.base.errors import InputError
from bcid.forms.forward import Forward
from bcid.forms.model import check_physics
from bcid.forms.simulate import simulate
from bcid.measurement import Action

YOUNG, POISSON, THICKNESS, LENGTH, HEIGHT = 20e3, 0.4, 1e-3, 60e-3, 20e-3
SHEET = """SetFactory("OpenCASCADE");
DefineConstant[ h = {10, Name "element size in mm"} ];
e = 1e-3;
Rectangle(1) = {0, 0, 0, LENGTH, HEIGHT};
Physical Surface("whole") = Surface{:};
Physical Curve("left") = Curve In BoundingBox{-e, -e, -e, e, HEIGHT+e, e};
Physical Curve("right") = Curve In BoundingBox{LENGTH-e, -e, -e, LENGTH+e, HEIGHT+e, e};
Physical Curve("low") = Curve In BoundingBox{-e, -e, -e, LENGTH+e, e, e};
Physical Curve("up") = Curve In BoundingBox{-e, HEIGHT-e, -e, LENGTH+e, HEIGHT+e, e};
Mesh.MeshSizeMin = h; Mesh.MeshSizeMax = h;
"""
SCENE = """format = "bcid-scene/1"
[geometry]
file = "sheet.geo"
length_unit = "mm"
{geometry}
[[levels]]
element_size = "{size} mm"
degree = 2
[material]
law = "neo_hooke"
young = "20 kPa"
poisson = {poisson}
formulation = "{formulation}"
{held}
[grasps]
jaw = {{ on = "right", centre = "{length} {middle} 0 mm" }}
[fiducials]
{markers}
{more}
"""
FLAT = 'thickness = "1 mm"'
WRINKLED = FLAT + "\nwrinkles = true"
ROLLERS = (
    '[held]\nleft = { on = "left", along = "x" }\nlow = { on = "low", along = "y" }\nup = { on = "up", along = "y" }'
)
CLAMPED = '[held]\nclamp = "left"'


def sheet(folder: Path, geometry: str = WRINKLED, length: int = 60, height: int = 20, **change: Any) -> Scene:
    """A sheet of 60 x 20 mm."""
    folder.mkdir(parents=True, exist_ok=True)
    program = SHEET.replace("LENGTH", str(length)).replace("HEIGHT", str(height))
    (folder / "sheet.geo").write_text(program, encoding="utf-8")
    places = [(x * length, y * height) for x in (0.25, 0.5, 0.75) for y in (0.2, 0.5, 0.8)]
    markers = "\n".join(f'm{k} = "{x} {y} 0 mm"' for k, (x, y) in enumerate(places))
    usual = {"held": CLAMPED, "more": "", "size": 5, "poisson": POISSON, "formulation": "displacement"}
    text = SCENE.format(geometry=geometry, markers=markers, length=length, middle=height / 2, **(usual | change))
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return Scene.read(folder / "scene.toml", physics=check_physics)


def action(way: np.ndarray, turn: float = 0.0, steps: int = 3) -> Action:
    """The jaw moves by a way (3,), m, and turns in the plane by an angle, rad."""
    part = np.linspace(0, 1, steps)
    turned = np.c_[np.cos(part * turn / 2), 0 * part, 0 * part, np.sin(part * turn / 2)]
    return Action("1", np.arange(steps), np.arange(steps), "jaw", part[:, None] * way, turned)


def pull(scene: Scene, way: np.ndarray, turn: float = 0.0, steps: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Displacements of the markers, and forces and torques of the jaw (steps, 6)."""
    forward = Forward(scene, 0)
    found = forward.predict((), [action(np.asarray(way), turn, steps)], keep=True)
    assert not found.failure
    wrench = forward.detail((), [action(np.asarray(way), turn, steps)], found).wrench
    forward.destroy()
    assert wrench is not None
    return found.positions - scene.rest, wrench


def tension(stretch: float) -> float:
    """Force of a sheet of neo-Hooke's law in uniaxial tension, N (Bonet & Wood, chapter 6)."""
    shear = YOUNG / (2 * (1 + POISSON))
    first = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    width = brentq(lambda x: shear * (x**2 - 1) + first * np.log(stretch * x**2), 0.3, 3.0, xtol=1e-14)
    return float((shear * (stretch**2 - 1) + first * np.log(stretch * width**2)) / stretch * HEIGHT * THICKNESS)


def test_a_sheet_pushed_together_is_in_uniaxial_tension(tmp_path: Path) -> None:
    """Between rollers it is a fifth narrower than at rest, and stretched by up to 15 %; the jaw leads along x alone."""
    more = '[effects.prestrain]\nsx = 1\nsy = 0.8\nsz = 1\n[effects.sliding_grip]\nacross = "0 Pa/m"'
    _, wrench = pull(sheet(tmp_path, held=ROLLERS, more=more), (0.15 * LENGTH, 0, 0))
    np.testing.assert_allclose(wrench[1:, 0], [tension(1.075) / 0.8, tension(1.15) / 0.8], rtol=5e-3)


@pytest.mark.parametrize(("mean", "bent"), [(0.02, 0.01), (0.01, 0.02), (0.003, 0.02)])
def test_moment_of_a_stretched_strip_is_that_of_stein_and_hedgepeth(tmp_path: Path, mean: float, bent: float) -> None:
    """NASA TN D-813 (1961): M/(P h) = 1/2 - sqrt(2 P/(E t h^2 k))/3 where it exceeds 1/6, and no wrinkles below.

    The stress of a sheet that has buckled is up to 3 % of the mean tension here. Without Poisson's ratio both ends stay as they
    are, so that the strip may be short: its deflection is then small against h.
    """
    text = {"length": 20, "height": 60, "poisson": 0.0}
    scene = sheet(tmp_path, held='[held]\nleft = { on = "left", along = "x" }', **text)
    length, height = 20e-3, 60e-3
    curvature = 2 * bent / height
    _, wrench = pull(scene, (mean * length, 0, 0), curvature * length)
    tensile, moment = abs(wrench[-1, 0]), abs(wrench[-1, 5])
    stiffness = YOUNG * THICKNESS * height**2 * curvature
    flat = stiffness / (12 * tensile)
    expected = flat if flat < 1 / 6 else 1 / 2 - np.sqrt(2 * tensile / stiffness) / 3
    assert moment / (tensile * height) == pytest.approx(expected, rel=0.03)


def test_a_sheet_in_tension_is_that_which_stays_flat(tmp_path: Path) -> None:
    """Stretched along both axes; the quadrature is another one."""
    (moved, force), (other, same) = (
        pull(sheet(tmp_path / str(len(kind)), kind, held=ROLLERS), (0.1 * LENGTH, 0, 0)) for kind in (FLAT, WRINKLED)
    )
    np.testing.assert_allclose(moved, other, atol=1e-4 * LENGTH)
    np.testing.assert_allclose(force, same, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"geometry": "wrinkles = true"}, r"geometry\.wrinkles: only a sheet wrinkles: state its thickness"),
        ({"geometry": FLAT + "\nwrinkles = 1"}, r"geometry\.wrinkles: expected true or false, found 1"),
        (
            {"more": '[effects.fibres]\nk1 = "1 kPa"\nangle = "0 deg"'},
            r"geometry\.wrinkles: fibres cannot act in a sheet",
        ),
        ({"formulation": "mixed"}, r'geometry\.wrinkles: .*needs formulation = "displacement"'),
    ],
)
def test_what_cannot_wrinkle_is_refused(tmp_path: Path, change: dict[str, str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        sheet(tmp_path, **change)


def test_wrinkles_are_part_of_the_fingerprint(tmp_path: Path) -> None:
    flat, wrinkled, stated = (sheet(tmp_path, geometry) for geometry in (FLAT, WRINKLED, FLAT + "\nwrinkles = false"))
    assert flat.fingerprint() == stated.fingerprint() != wrinkled.fingerprint()


PATCHES = CLAMPED + '\n[patches]\nnear = { box = ["-1 19 -1 mm", "31 21 2 mm"] }'


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Measurement:
    """A sheet that wrinkles, held at its end alone: sheared by a fifth of its length, with forces."""
    scene = sheet(tmp_path_factory.mktemp("true"), held=PATCHES, size=4)
    seen = action(np.array([0.002, 0.012, 0.0]), steps=4)
    return simulate(scene, set(), [seen], noise=0.05e-3, wrench=True, wrench_noise=1e-4)


def test_answer_is_right_with_the_line_and_not_without(tmp_path: Path, measured: Measurement) -> None:
    answers = {}
    for kind in (WRINKLED, FLAT):
        found = identify(sheet(tmp_path / str(len(kind)), kind, held=PATCHES, size=7), measured)
        interval = found.stiffness.constants["young"].interval
        answers[kind] = found.anchored, found.discrepancy_probability, interval[0] < YOUNG < interval[1]
        assert ("which wrinkles where it would be pushed together" in found.summary) == (kind == WRINKLED)
    assert answers[WRINKLED][0] == ()
    assert answers[WRINKLED][1] < 0.5
    assert answers[WRINKLED][2]
    assert answers[FLAT][1] > 0.99
    assert not answers[FLAT][2]
