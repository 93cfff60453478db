"""Candidate patches that hold along the normal of their surface, or within it: free of a slope, sliding, or sticking to it?"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from verify.problems import box, move, scene_of

from bcid import Measurement, Scene, identify
from bcid.app.cli import main
from bcid.base.errors import InputError
from bcid.forms.effects import effect
from bcid.forms.forward import Forward
from bcid.forms.mesh import BodyMesh
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.set_tangent import SetTangents
from bcid.forms.simulate import simulate
from bcid.forms.solver.equilibrium import Settings
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.scene.parts import Level
from bcid.search.fitting.loosened import loosened
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
COUNT = 4
SIZE = (0.06, 0.02, 0.02)
WAY = np.array([0.006, 0.001, 0.003])
MARKERS = {"a": (0.02, 0.02, 0.01), "b": (0.04, 0.0, 0.012), "c": (0.045, 0.01, 0.02), "d": (0.03, 0.01, 0.0)}


# ---------------------------------------------------------------- where the normal is an axis, or was one


def lying(axes: dict[str, tuple[int, ...]], directions: dict[str, str], degree: int, formulation: str) -> Scene:
    """A block that may be held at its foot and at its bottom in two ways; the end is led."""
    scene = scene_of(("x0", "z0"), "x1", (SIZE[0], SIZE[1] / 2, SIZE[2] / 2), fiducials=MARKERS, degree=degree)
    patches = {"foot": scene.patches["x0"], "slides": scene.patches["z0"], "sticks": scene.patches["z0"]}
    material = replace(scene.material, formulation=formulation)
    return replace(scene, patches=patches, patch_axes=axes, patch_directions=directions, material=material)


def turned(scene: Scene, mesh: BodyMesh, turn: Rotation) -> tuple[Scene, BodyMesh]:
    """The same in other axes."""
    grasp = replace(scene.grasps["x1"], centre=tuple(turn.apply(scene.grasps["x1"].centre)))
    markers = {name: tuple(turn.apply(place)) for name, place in scene.fiducials.items()}
    mesh = BodyMesh(turn.apply(mesh.points), mesh.cells, mesh.groups)
    return replace(scene, grasps={"x1": grasp}, fiducials=markers), mesh


def shown(scene: Scene, mesh: BodyMesh, anchors: set[str], way: Array) -> tuple[Array, Array]:
    """Displacements of the markers (m) and force and torque of the gripper in all frames."""
    forward = Forward(scene, 0, None, None, Settings(rtol=1e-10), mesh)
    action = move(np.linspace(0, 1, COUNT)[:, None] * way, "x1")
    found = forward.predict(anchors, [action], keep=True)
    assert found.complete, found.failure
    found = forward.detail(anchors, [action], found)
    forward.destroy()
    assert found.wrench is not None
    return found.positions - scene.rest, found.wrench


AXES: dict[str, tuple[int, ...]] = {"slides": (2,), "sticks": (0, 1)}
DIRECTIONS = {"slides": "normal", "sticks": "tangent"}


@pytest.mark.parametrize(("degree", "formulation"), [(1, "displacement"), (2, "displacement"), (2, "mixed")])
@pytest.mark.parametrize("anchors", [{"foot", "slides"}, {"slides"}, {"sticks"}, {"foot", "slides", "sticks"}])
def test_along_the_normal_is_along_the_axis_that_it_is(anchors: set[str], degree: int, formulation: str) -> None:
    """The gripper leads nodes of the bottom away from it: they are its business alone, and those beside them are held."""
    mesh = box(SIZE, (6, 2, 2))
    by_axes, by_surface = (lying(*along, degree, formulation) for along in ((AXES, {}), ({}, DIRECTIONS)))
    expected, force = shown(by_axes, mesh, anchors, WAY)
    found, other = shown(by_surface, mesh, anchors, WAY)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
    np.testing.assert_allclose(other, force, atol=1e-3 * np.abs(force).max())
    turn = Rotation.from_euler("xyz", [20, 30, -40], degrees=True)
    aslant, _ = shown(*turned(by_surface, mesh, turn), anchors, turn.apply(WAY))
    np.testing.assert_allclose(turn.inv().apply(aslant.reshape(-1, 3)).reshape(found.shape), found, atol=1e-8)


def test_a_curved_face_slides_as_a_shaft_in_its_bearing() -> None:
    """A ring that is turned a little by its outer face about a shaft that it may slide on is hardly strained.

    Were each facet held along its own normal, the nodes between them could not move at all.
    """
    around = box((1.0, 1.0, 0.01), (1, 24, 1), warp=_ring)
    scene = scene_of(("x0",), "x1", (0.0, 0.0, 0.0), fiducials={"m": (0.0, 0.014, 0.005)}, degree=2)
    turn = np.linspace(0.0, np.radians(1), 3)
    turns = np.column_stack([np.cos(turn / 2), 0 * turn, 0 * turn, np.sin(turn / 2)])
    action = move(np.zeros((3, 3)), "x1", rotations=turns)
    energies = {}
    for along in ("normal", "tangent"):
        own = replace(scene, patch_directions={"x0": along}, attach_within=2e-3)
        forward = Forward(own, 0, None, None, Settings(rtol=1e-10), around)
        found = forward.detail({"x0"}, [action], forward.predict({"x0"}, [action], keep=True))
        assert found.energy is not None
        energies[along] = float(found.energy[-1].mean())
        forward.destroy()
    assert energies["normal"] < 0.02 * energies["tangent"]


def _ring(points: Array) -> Array:
    """Unit square and height to half a ring between radii of 10 and 18 mm."""
    radius, angle = 0.010 + 0.008 * points[:, 0], np.pi * points[:, 1]
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), points[:, 2]])


# ---------------------------------------------------------------- a ramp


@pytest.fixture(scope="module")
def ramp(project: Path) -> Scene:
    return Scene.read(project / "examples" / "scenes" / "ramp.toml", physics=check_physics)


def pulled(part: float = 1.0) -> list[Action]:
    """The end is led uphill and away from the ramp."""
    return [move(part * np.linspace(0, 1, COUNT)[:, None] * [0.005, 0.0, 0.002], "jaw")]


def seen(scene: Scene, anchors: set[str]) -> Measurement:
    """On a finer mesh."""
    return simulate(replace(scene, levels=(Level(2, 0.005),)), anchors, pulled(), noise=0.05e-3, random_state=2)


@pytest.mark.parametrize(
    "anchors", [{"foot"}, {"foot", "slides"}, {"foot", "slides", "sticks"}], ids=["free", "sliding", "sticking"]
)
def test_a_body_on_a_ramp_is_free_slides_or_sticks(ramp: Scene, anchors: set[str]) -> None:
    found = identify(ramp, seen(ramp, anchors))
    assert set(found.anchored) == anchors
    assert found.probability > 0.95
    assert f"{'anchored' if 'slides' in anchors else 'free'} along its normal" in found.summary
    assert f"{'anchored' if 'sticks' in anchors else 'free'} along its surface" in found.summary


def test_without_the_directions_a_body_that_slides_neither_sticks_nor_is_free(ramp: Scene) -> None:
    measured = seen(ramp, {"foot", "slides"})
    rms = []
    for scene, sets in (
        (ramp, [{"foot", "slides"}]),
        (replace(ramp, patch_directions={}), [{"foot"}, {"foot", "slides"}]),
    ):
        forward = Forward(scene, 1)
        rms += [np.sqrt(np.mean((forward.predict(s, pulled()).positions - measured.positions) ** 2)) for s in sets]
        forward.destroy()
    assert rms[0] < 0.06e-3
    assert min(rms[1:]) > 2 * rms[0]


def test_its_tangent_tells_other_sets_to_first_order(ramp: Scene) -> None:
    """Small steps: what every set shows about one that was followed is what it shows when it is followed itself."""
    forward = Forward(ramp, 0)
    tractions = SetTangents(forward).tractions
    assert {name: len(numbers) for name, numbers in tractions.items()} == {"foot": 18, "slides": 6, "sticks": 12}
    forward.destroy()
    small = pulled(0.01)
    predictor = Predictor(ramp, simulate(ramp, {"foot"}, small, level=0, noise=0.0), MPI.COMM_SELF, level=0)
    model = Model.of(ramp)
    for first in ({"foot"}, {"foot", "slides"}):
        about = predictor.predict(model, first, keep=True)
        for then in ({"foot"}, {"foot", "slides"}, {"foot", "sticks"}, {"foot", "slides", "sticks"}):
            told = predictor.moves(model, first, about, [frozenset(then)])[0]
            change = predictor.predict(model, then).positions - about.positions
            assert np.abs(told - change).max() <= 0.2 * np.abs(change).max() + 1e-9, (first, then)
    predictor.destroy()


def test_what_holds_along_its_normal_comes_off_but_is_not_soft(ramp: Scene) -> None:
    soft = effect("soft_anchor")
    assert soft.places is not None
    every = frozenset(ramp.patches)
    assert soft.places(ramp, every) == ["", "foot"]
    assert soft.places(replace(ramp, patches={"slides": ramp.patches["slides"]}), frozenset({"slides"})) == []
    model = Model.of(ramp)
    shown = {}
    for name, term, anchors in (
        ("rigid", None, {"foot", "slides"}),
        ("soft", Term("soft_anchor", {"stiffness": 1e12}), {"foot", "slides"}),
        ("off", Term("release", {"released": 1.0, "onset": 0.0}, place="slides"), {"foot", "slides"}),
        ("free", None, {"foot"}),
    ):
        forward = Forward(ramp, 0, None, model + term if term else model)
        shown[name] = forward.predict(anchors, pulled()).positions
        forward.destroy()
    assert np.abs(shown["rigid"] - shown["free"]).max() > 0.3e-3
    np.testing.assert_allclose(shown["soft"], shown["rigid"], atol=2e-6)
    np.testing.assert_allclose(shown["off"], shown["free"], atol=1e-8)


def test_a_set_that_gives_has_a_sliding_patch_that_does_not(ramp: Scene) -> None:
    anchors = frozenset({"foot", "slides"})
    measured = simulate(ramp, anchors, pulled(), level=0, noise=0.05e-3, random_state=1)
    predictor = Predictor(ramp, measured, MPI.COMM_SELF, level=0)
    state = State.of(predictor, Model.of(ramp), anchors)
    found = loosened(state, effect("soft_anchor"), [anchors], [anchors])
    predictor.destroy()
    by_place = {place: [one for one in found if one.term.place == place] for place in ("", "foot")}
    assert len(found) == sum(map(len, by_place.values()))
    for whole, part in zip(*by_place.values(), strict=True):
        assert whole.term.values == part.term.values
        np.testing.assert_allclose(whole.moved, part.moved, rtol=1e-9, atol=1e-9)


def test_scene_check_tells_along_what_a_patch_holds(ramp: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", "check", ramp.source]) == 0
    said = capsys.readouterr().out
    assert "its normal" in said
    assert "its surface" in said
    assert "share" not in said


def test_two_patches_that_hold_the_same_are_told(
    ramp: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["scene", "check", str(changed(ramp, tmp_path, 'along = "tangent"', 'along = "x"'))]) == 0
    assert "patches slides and sticks share" in capsys.readouterr().out


def test_a_soft_anchor_that_would_be_along_a_normal_is_refused(ramp: Scene, tmp_path: Path) -> None:
    path = changed(ramp, tmp_path, "", "")
    stated = '\n[effects.soft_anchor]\nplace = "slides"\nstiffness = "1 MPa/m"\n'
    path.write_text(path.read_text(encoding="utf-8") + stated, encoding="utf-8")
    with pytest.raises(InputError, match=r"soft_anchor: place = 'slides'; .*known: foot"):
        Scene.read(path, physics=check_physics)


def test_directions_change_the_fingerprint_and_pieces_have_them(ramp: Scene) -> None:
    assert replace(ramp, patch_directions={}).fingerprint() != ramp.fingerprint()
    pieces = replace(ramp, patches=dict.fromkeys(("slides.1", "slides.2.1", "foot.1"), ramp.patches["slides"]))
    assert pieces.held_direction("slides.2.1") == "normal"
    assert pieces.held_along("slides.1") == ()
    assert pieces.held_along("foot.1") == (0, 1, 2)


def changed(scene: Scene, folder: Path, old: str, new: str) -> Path:
    """The scene's file with something else in it."""
    text = Path(scene.source).read_text(encoding="utf-8").replace("../../meshes/geo/ramp.geo", str(scene.geometry))
    path = folder / "scene.toml"
    path.write_text(text.replace(old, new) if old else text, encoding="utf-8")
    return path
