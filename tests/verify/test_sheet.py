"""Sheets: a flat mesh and a thickness. Plane stress without buckling; stiffness per thickness where that is not known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import brentq

from bcid import Measurement, Scene, fit, identify
from bcid.base.errors import InputError
from bcid.forms.forward import Forward
from bcid.forms.mesh import level_mesh
from bcid.forms.model import Model, check_physics, traction
from bcid.forms.simulate import simulate
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose
from bcid.measurement import Action
from bcid.scene import Level
from bcid.search.answer.source import fitting

YOUNG, POISSON, THICKNESS = 20e3, 0.4, 2e-3
FLAT = """SetFactory("OpenCASCADE");
DefineConstant[ h = {10, Name "element size in mm"} ];
e = 1e-3;
Rectangle(1) = {0, 0, 3, 60, 30};
Point(100) = {30, 30, 3};
BooleanFragments{ Surface{1}; Delete; }{ Point{100}; Delete; }
Physical Surface("whole") = Surface{:};
Physical Curve("left") = Curve In BoundingBox{-e, -e, 0, e, 30+e, 4};
Physical Curve("right") = Curve In BoundingBox{60-e, -e, 0, 60+e, 30+e, 4};
Physical Curve("low") = Curve In BoundingBox{-e, -e, 0, 60+e, e, 4};
Physical Curve("up") = Curve In BoundingBox{-e, 30-e, 0, 30+e, 30+e, 4};
Physical Curve("far") = Curve In BoundingBox{30-e, 30-e, 0, 60+e, 30+e, 4};
Mesh.MeshSizeMin = h; Mesh.MeshSizeMax = h;
"""
# The same in space, about the same middle plane.
SOLID = """SetFactory("OpenCASCADE");
DefineConstant[ h = {10, Name "element size in mm"} ];
e = 1e-3;
Rectangle(1) = {0, 0, 2, 60, 30};
Point(100) = {30, 30, 2};
BooleanFragments{ Surface{1}; Delete; }{ Point{100}; Delete; }
Extrude {0, 0, 2} { Surface{:}; Layers{2}; }
Physical Volume("body") = Volume{:};
Physical Surface("left") = Surface In BoundingBox{-e, -e, 0, e, 30+e, 5};
Physical Surface("right") = Surface In BoundingBox{60-e, -e, 0, 60+e, 30+e, 5};
Physical Surface("low") = Surface In BoundingBox{-e, -e, -e, 60+e, e, 5};
Physical Surface("up") = Surface In BoundingBox{-e, 30-e, -e, 30+e, 30+e, 5};
Mesh.MeshSizeMin = h; Mesh.MeshSizeMax = h;
"""
TILTED = FLAT.replace("Physical Surface", "Rotate {{1, 0, 0}, {0, 0, 3}, 0.2} { Surface{:}; }\nPhysical Surface")
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
poisson = 0.4
{held}
[grasps]
jaw = {{ on = "right", centre = "60 15 3 mm" }}
[fiducials]
a = "15 8 3 mm"
b = "30 15 3 mm"
c = "44 24 3 mm"
"""
SLIDES = '[held]\nleft = { on = "left", along = "x" }\nlow = { on = "low", along = "y" }'
CLAMPED = '[held]\nclamp = "left"'


def sheet(
    folder: Path, held: str = CLAMPED, thickness: str = 'thickness = "2 mm"', geometry: str = FLAT, size: float = 10
) -> Scene:
    """A sheet of 60 x 30 mm."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sheet.geo").write_text(geometry, encoding="utf-8")
    text = SCENE.format(held=held, geometry=thickness, size=size)
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return Scene.read(folder / "scene.toml", physics=check_physics)


def across(*stretches: float) -> float:
    """The other principal stretches, of which the stress vanishes: (mu (x^2 - 1) + lambda ln J = 0, Bonet & Wood, chapter 6)."""
    shear = YOUNG / (2 * (1 + POISSON))
    first = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    free, rest = 3 - len(stretches), float(np.log(np.prod(stretches)))
    return float(brentq(lambda x: shear * (x**2 - 1) + first * (rest + free * np.log(x)), 0.3, 3.0, xtol=1e-14))


def nominal(stretch: float, *others: float) -> float:
    """First Piola-Kirchhoff stress along the first of three principal stretches, Pa."""
    shear = YOUNG / (2 * (1 + POISSON))
    first = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    return float((shear * (stretch**2 - 1) + first * np.log(stretch * np.prod(others))) / stretch)


@pytest.mark.parametrize("stretches", [(1.3,), (0.9,), (1.25, 1.1), (1.2, 0.95)])
def test_plane_stress_is_that_of_the_closed_form(tmp_path: Path, stretches: tuple[float, ...]) -> None:
    """Pulled by dead tractions along x, or along x and y, at all nodes."""
    scene = sheet(tmp_path, SLIDES)
    third = across(*stretches)
    x, y, z = (*stretches, third, third)[:3]
    places = scene.places | {
        "pulled": replace(scene.grasps["jaw"].region),
        "up": replace(scene.places["low"], groups=("up", "far")),
    }
    scene = replace(scene, places=places)
    model = Model.of(scene) + traction("pulled", (nominal(x, y, z), 0.0, 0.0))
    if len(stretches) > 1:
        model += traction("up", (0.0, nominal(y, x, z), 0.0))
    forward = Forward(scene, 0, model=model)
    forward.equilibrium.hold((), "")
    start = forward.body.nodes - [0.0, 0.0, 3e-3]
    # Not from the answer, but near enough for one step.
    guess = (start * (np.array([x, y, z]) - 1) * 0.9).ravel()
    assert forward.equilibrium.solve(Pose(), guess) is Status.CONVERGED
    moved = forward.equilibrium.displacement().reshape(-1, 3)
    forward.destroy()
    expected = start * (np.array([x, y, z]) - 1)
    assert np.abs(moved - expected).max() < 1e-6 * np.abs(expected).max()


def pull(scene: Scene, way: np.ndarray, steps: int = 3) -> tuple[np.ndarray, np.ndarray, str]:
    """Displacements of the markers at the end (3, 3), m, force there (3,), N, and why it ended early, if it did."""
    path = np.linspace(0, 1, steps)[:, None] * way
    action = Action("1", np.arange(steps), np.arange(steps), "jaw", path, np.tile([1.0, 0, 0, 0], (steps, 1)))
    forward = Forward(scene, 0)
    found = forward.predict((), [action], keep=True)
    force = forward.detail((), [action], found).wrench
    forward.destroy()
    assert force is not None
    failure = found.failure
    return found.positions[-1] - scene.rest, force[-1, :3], failure.reason if failure else ""


def test_a_sheet_is_the_solid_in_tension_and_shear(tmp_path: Path) -> None:
    way = np.array([0.012, 0.004, 0.0])
    moved, force, _ = pull(sheet(tmp_path / "flat", size=6), way)
    solid, true, _ = pull(sheet(tmp_path / "solid", thickness="", geometry=SOLID, size=3), way)
    assert np.abs(moved - solid)[:, :2].max() < 0.005 * 0.012
    np.testing.assert_allclose(force[:2], true[:2], rtol=0.01)


def test_a_sheet_does_not_buckle(tmp_path: Path) -> None:
    """Pushed by 5 % of its length: 30 times what it takes to buckle the solid."""
    way = np.array([-0.003, 0.0, 0.0])
    moved, force, failure = pull(sheet(tmp_path / "flat", size=6), way)
    assert not failure
    assert np.isfinite(moved).all()
    assert (force[2], moved[:, 2].any()) == (0, False)
    _, _, why = pull(sheet(tmp_path / "solid", thickness="", geometry=SOLID, size=6), way)
    assert "it buckles" in why


def test_forces_are_in_proportion_to_the_thickness(tmp_path: Path) -> None:
    way = np.array([0.006, 0.0, 0.0])
    found = [
        pull(sheet(tmp_path / str(k), thickness=f'thickness = "{thickness}"'), way)
        for k, thickness in enumerate(("0.01 mm", "0.1 mm", "1 mm"))
    ]
    for moved, _force, _ in found:
        np.testing.assert_allclose(moved[:, :2], found[-1][0][:, :2], atol=0.005 * 0.006)
    np.testing.assert_allclose(found[0][1] * 100, found[-1][1], rtol=0.01, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"thickness": ""}, r'holds triangles and no tetrahedra; .*thickness = "2 mm"'),
        ({"geometry": SOLID}, r"geometry\.thickness is that of a sheet, .*holds tetrahedra"),
        ({"geometry": TILTED}, r"do not lie in a plane z = const"),
        ({"thickness": 'thickness = "-1 mm"'}, r"geometry\.thickness: '-1 mm' must be positive"),
        ({"thickness": "thickness = 2"}, r"geometry\.thickness: "),
        ({"held": '[held]\nmid_plane = "left"'}, r"the middle plane of a sheet is called 'mid_plane'"),
        ({"geometry": FLAT.replace('"low"', '"mid_plane"')}, r"has a physical group 'mid_plane'"),
        ({"held": ""}, r"patches: none is defined"),
    ],
)  # fmt: skip
def test_what_is_no_sheet_is_refused(tmp_path: Path, change: Mapping[str, str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Forward(sheet(tmp_path, **change), 0)


PATCHES = CLAMPED + '\n[patches]\nlow = "low"\nup = "up"'


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Measurement:
    """A solid sheet of 2 mm, held at its upper edge besides: pulled by 8 mm, with forces."""
    scene = sheet(tmp_path_factory.mktemp("true"), PATCHES, thickness="", geometry=SOLID, size=3)
    path = np.linspace(0, 1, 5)[:, None] * [0.006, -0.005, 0.0]
    pull = Action("1", np.arange(5), np.arange(5), "jaw", path, np.tile([1.0, 0, 0, 0], (5, 1)))
    return simulate(scene, {"up"}, [pull], noise=0.02e-3, wrench=True, wrench_noise=1e-3)


def test_unknown_thickness_gives_stiffness_per_thickness(tmp_path: Path, measured: Measurement) -> None:
    """20 kPa of 2 mm are 0.04 N/mm; the scene has 60 kPa of 1 mm."""
    scene = sheet(tmp_path, PATCHES, 'thickness = "unknown"')
    scene = replace(scene, material=replace(scene.material, values={"young": "60 kPa", "poisson": 0.4}))
    found = identify(scene, measured)
    assert found.anchored == ("up",)
    told = found.stiffness.constants["young"]
    low, high = told.interval
    assert low < YOUNG * THICKNESS * 1e-3 < high < 1.5 * low
    assert (told.unit, told.scene) == ("N/mm", pytest.approx(0.06))
    assert "young x thickness = 0.0" in found.summary
    assert "N/mm (95 %" in found.summary
    assert "the thickness is unknown, so that the constants themselves are not known" in found.summary
    assert "Its thickness is unknown, and it is computed with 1 mm" in found.summary
    fitted = fit(scene, measured, free=["young"], anchors=["up"])
    law = fitted.law["young"]
    assert law.unit == "N/mm"
    assert law.interval[0] < 0.04 < law.interval[1]
    assert "young x thickness = " in fitted.summary


def test_known_thickness_gives_the_constants(tmp_path: Path, measured: Measurement) -> None:
    scene = sheet(tmp_path, PATCHES)
    found = identify(scene, measured)
    told = found.stiffness.constants["young"]
    assert told.unit == "Pa"
    assert told.interval[0] < YOUNG < told.interval[1]
    assert "A sheet of 18 cm^2 and a thickness of 2 mm, in plane stress" in found.summary
    assert "thickness is unknown" not in found.summary


def test_what_is_seen_across_the_plane_is_not_compared(tmp_path: Path, measured: Measurement) -> None:
    scene = sheet(tmp_path, PATCHES)
    _, seen = fitting(scene, measured, MPI.COMM_SELF)
    assert np.isnan(seen.positions[..., 2]).all()
    assert np.isfinite(seen.wrenches).all(axis=0).tolist() == [True, True, False, False, False, True]
    lifted = measured.data.copy(deep=True)
    lifted["translation"][{"axis": 2}] += np.linspace(0, 5e-3, 5)
    with pytest.raises(
        InputError, match=r"action 1: the gripper leaves the plane of the sheet, by up to 5 mm and 0 deg"
    ):
        fitting(scene, replace(measured, data=lifted), MPI.COMM_SELF)


def test_a_mesh_file_is_refined_in_its_plane(tmp_path: Path) -> None:
    """Two triangles in a file of meshio, twice refined."""
    points = np.array([[0, 0, 0], [60, 0, 0], [60, 30, 0], [0, 30, 0]], dtype=float)
    tmp_path.mkdir(exist_ok=True)
    meshio.Mesh(points, [("triangle", [[0, 1, 2], [0, 3, 2]])]).write(tmp_path / "sheet.vtu")
    text = SCENE.format(
        held='[held]\nleft = { box = ["-1 -1 -1 mm", "1 31 5 mm"] }', geometry='thickness = "2 mm"', size=1
    )
    text = text.replace("sheet.geo", "sheet.vtu").replace('element_size = "1 mm"', "refinements = 2")
    text = text.replace('on = "right"', 'on = { box = ["59 -1 -1 mm", "61 31 5 mm"] }').replace("3 mm", "0 mm")
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    mesh = level_mesh(scene := Scene.read(tmp_path / "scene.toml"), scene.levels[0])
    assert len(mesh.cells) == 2 * 16 * 3
    assert np.unique(mesh.points[:, 2]).tolist() == [0.0, 2e-3]
    assert mesh.volume == pytest.approx(60 * 30 * 2 * 1e-9)
    moved, _, failure = pull(scene, np.array([0.006, 0.0, 0.0]))
    assert not failure
    assert moved[1, 0] == pytest.approx(0.003, rel=0.02)


def test_anchors_of_the_example_are_found(project: Path) -> None:
    """examples/scenes/sheet.toml, pulled in a mesh of elements of another degree."""
    scene = Scene.read(project / "examples" / "scenes" / "sheet.toml", physics=check_physics)
    path = np.linspace(0, 1, 4)[:, None] * [0.0033, 0.0011, 0.0]
    pull = Action("1", np.arange(4), np.arange(4), "jaw", path, np.tile([1.0, 0, 0, 0], (4, 1)))
    seen = simulate(replace(scene, levels=(Level(3, 0.004),)), {"up_2"}, [pull], noise=0.02e-3, random_state=1)
    found = identify(scene, seen)
    assert found.anchored == ("up_2",)
    assert found.probability > 0.99
    assert found.discrepancy_probability < 0.5


def test_a_gripper_that_lifts_a_little_leads_in_the_plane(tmp_path: Path) -> None:
    scene = sheet(tmp_path)
    flat, force, _ = pull(scene, np.array([0.006, 0.0, 0.0]))
    lifted, other, _ = pull(scene, np.array([0.006, 0.0, 0.002]))
    np.testing.assert_allclose(lifted, flat, atol=1e-12)
    np.testing.assert_allclose(other, force, atol=1e-9)


def test_a_thickness_is_part_of_the_fingerprint(tmp_path: Path) -> None:
    scene = sheet(tmp_path)
    others = [replace(scene, thickness=1e-3), replace(scene, thickness_known=False)]
    assert len({one.fingerprint() for one in (scene, *others)}) == 3
