"""What a scene knows to be held: a glued pad, a plane of symmetry. It holds in every hypothesis, and is no candidate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid.base.errors import InputError
from bcid.base.options import IdentifyOptions
from bcid.forms.forward import Forward
from bcid.forms.model import Model, check_physics
from bcid.measurement import Measurement
from bcid.predict.predictor import Predictor
from bcid.scene import Scene
from bcid.scene.action import Action
from bcid.search.identify import identify

# A bar of which one end is pulled; its axis is x. The lower end is another place than the plane x = LOW.
BAR = """SetFactory("OpenCASCADE");
DefineConstant[ h = {{8, Name "element size in mm"}} ];
Box(1) = {{{low}, 0, 0, {length}, 12, 10}};
Physical Volume("body") = {{1}};
e = 1e-3;
Physical Surface("low") = Surface In BoundingBox{{{low}-e, -e, -e, {low}+e, 12+e, 10+e}};
Physical Surface("high") = Surface In BoundingBox{{40-e, -e, -e, 40+e, 12+e, 10+e}};
Mesh.MeshSizeMin = h; Mesh.MeshSizeMax = h;
"""
SCENE = """format = "bcid-scene/1"
[geometry]
file = "bar.geo"
length_unit = "mm"
[[levels]]
element_size = "5 mm"
degree = 2
[material]
law = "neo_hooke"
young = "20 kPa"
poisson = 0.4
{held}
[patches]
{patches}
[grasps]
jaw = {{ on = "high", centre = "40 6 5 mm" }}
[fiducials]
a = "8 12 3 mm"
b = "20 12 8 mm"
c = "31 2 10 mm"
"""


def bar(folder: Path, low: float, held: str, patches: str) -> Scene:
    """A bar from `low` (mm) to 40 mm."""
    folder.mkdir()
    (folder / "bar.geo").write_text(BAR.format(low=low, length=40 - low), encoding="utf-8")
    (folder / "scene.toml").write_text(SCENE.format(held=held, patches=patches), encoding="utf-8")
    return Scene.read(folder / "scene.toml", physics=check_physics)


def shown(scene: Scene, anchors: set[str], pull: float) -> np.ndarray:
    """Displacements of the markers at the end of a pull along x, shape (3, 3), m."""
    way = np.linspace(0, pull, 3)[:, None] * [1.0, 0.0, 0.0]
    still = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    forward = Forward(scene, 0)
    found = forward.predict(anchors, [Action("1", np.arange(3), np.arange(3), "jaw", way, still)])
    forward.destroy()
    return np.asarray(found.positions[-1] - scene.rest)


def test_a_plane_of_symmetry_stands_for_the_other_half(tmp_path: Path) -> None:
    whole = bar(tmp_path / "whole", -40, "", 'far = "low"')
    half = bar(tmp_path / "half", 0, '[held]\nmiddle = { on = "low", along = "x" }', 'low = "low"')
    assert half.held == {"middle": (0,)}
    assert Model.of(half).rollers == (("middle", 0),)
    expected = shown(whole, {"far"}, 0.016) - [0.008, 0, 0]
    np.testing.assert_allclose(shown(half, set(), 0.008), expected, atol=3e-5)
    free = bar(tmp_path / "free", 0, "", 'low = "low"')
    assert np.abs(shown(free, set(), 0.008) - expected).max() > 1e-3
    assert np.abs(shown(free, {"low"}, 0.008) - expected).max() > 1e-4


TILTED = """SetFactory("OpenCASCADE");
DefineConstant[ h = {{8, Name "element size in mm"}} ];
Box(1) = {{0, 0, 0, 40, 12, 10}};
Rotate {{{{0, 0, 1}}, {{0, 0, 0}}, {angle} * Pi / 180}} {{ Volume{{1}}; }}
Physical Volume("body") = {{1}};
Physical Surface("low") = {{1}};
Physical Surface("high") = {{2}};
Mesh.MeshSizeMin = h; Mesh.MeshSizeMax = h;
"""


def tilted(folder: Path, angle: float, held: str, patches: str = "") -> Scene:
    """Half of the bar, turned about z by an angle (deg)."""
    scene = bar(folder, 0, held, patches)
    (folder / "bar.geo").write_text(TILTED.format(angle=angle), encoding="utf-8")
    turned = scene.rest @ turn(angle).T
    grasp = scene.grasps["jaw"]
    x, y, z = turn(angle) @ np.array(grasp.centre)
    names = {name: (float(a), float(b), float(c)) for name, (a, b, c) in zip(scene.fiducials, turned, strict=True)}
    return replace(scene, fiducials=names, grasps={"jaw": replace(grasp, centre=(x, y, z))})


def turn(angle: float) -> np.ndarray:
    """Rotation about z by an angle (deg)."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def pulled(scene: Scene, angle: float) -> np.ndarray:
    """Displacements of the markers at the end of a pull of 8 mm along the bar, in its own axes, shape (3, 3), m."""
    way = np.linspace(0, 0.008, 3)[:, None] * turn(angle)[:, 0]
    still = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    forward = Forward(scene, 0)
    found = forward.predict((), [Action("1", np.arange(3), np.arange(3), "jaw", way, still)])
    forward.destroy()
    return np.asarray((found.positions[-1] - scene.rest) @ turn(angle))


def test_a_plane_of_symmetry_may_lie_in_any_direction(tmp_path: Path) -> None:
    """A bar that is held along its normal slides across: it is that of a roller along an axis, turned."""
    axis = pulled(tilted(tmp_path / "axis", 0, '[held]\nmiddle = { on = "low", along = "x" }'), 0)
    for angle in (0.0, 30.0):
        scene = tilted(tmp_path / f"normal-{angle:g}", angle, '[held]\nmiddle = { on = "low", along = "normal" }')
        assert scene.held == {"middle": ()}
        np.testing.assert_allclose(pulled(scene, angle), axis, atol=3e-5)
    fixed = pulled(tilted(tmp_path / "fixed", 0, '[held]\nmiddle = "low"'), 0)
    assert np.abs(fixed - axis).max() > 1e-4


def test_a_glued_pad_is_no_candidate(project: Path) -> None:
    slab = Scene.read(project / "examples" / "scenes" / "slab.toml")
    slab = replace(slab, patches={name: slab.patches[name] for name in "1234"})
    measured = Measurement.read(project / "examples" / "measurements" / "slab-12-semicircle")
    others = {name: region for name, region in slab.patches.items() if name != "2"}
    known = replace(slab, patches=others, places={"pad": slab.patches["2"]}, held={"pad": (0, 1, 2)})
    assert known.fingerprint() != replace(known, held={}).fingerprint()
    predictors = [Predictor(scene, measured, MPI.COMM_SELF, level=0) for scene in (slab, known)]
    both, one = (
        predictor.predict(Model.of(predictor.whole), anchors, keep=True)
        for predictor, anchors in zip(predictors, ({"1", "2"}, {"1"}), strict=True)
    )
    np.testing.assert_allclose(one.positions, both.positions, atol=1e-9)
    moves = [
        predictor.moves(Model.of(predictor.whole), anchors, found, [more])[0]
        for predictor, anchors, found, more in (
            (predictors[0], {"1", "2"}, both, frozenset({"1", "2", "4"})),
            (predictors[1], {"1"}, one, frozenset({"1", "4"})),
        )
    ]
    # The tangent has tractions of low order on a patch, and none on what is held.
    np.testing.assert_allclose(moves[1], moves[0], atol=0.1 * np.abs(moves[0]).max())
    for predictor in predictors:
        predictor.destroy()
    options = IdentifyOptions(exhaustive="no", level=1)
    found = identify(known, measured, options=options)
    assert (found.anchored, found.probability > 0.99, found.discrepancy_probability < 0.5) == (("1",), True, True)
    unknown = identify(replace(known, held={}), measured, options=options)
    assert unknown.discrepancy_probability > 0.99 or unknown.anchored != ("1",), (
        "a body that is held elsewhere is not explained"
    )


def test_what_is_wrong_with_what_is_held_is_said(tmp_path: Path) -> None:
    for number, (held, said) in enumerate(
        (
            ('[held]\npad = { on = "low", along = "u" }', r'held\.pad\.along: expected "x", "y" or "z", or a list'),
            ('[held]\npad = { on = "low", along = [] }', r"held\.pad\.along: expected"),
            ('[held]\npad = { on = "low", axis = "x" }', r"held\.pad\.axis: unknown key"),
            ("[held]\npad = 3", r"held\.pad: expected a physical group"),
            ('[places]\npad = "low"\n[held]\npad = "low"', r"held\.pad: has the name of one of \[places\]"),
        )
    ):
        with pytest.raises(InputError, match=said):
            bar(tmp_path / str(number), 0, held, 'low = "low"')
    twice = bar(tmp_path / "twice", 0, '[held]\npad = "low"', 'low = "low"')
    with pytest.raises(InputError, match=r"patch low and held pad share \d+ facets"):
        shown(twice, set(), 0.001)
    # What slides is a candidate for more.
    shown(bar(tmp_path / "slides", 0, '[held]\npad = { on = "low", along = ["x", "y"] }', 'low = "low"'), set(), 0.001)
