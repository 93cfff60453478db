"""Candidate patches that hold along some axes only: is a face free, does it slide, or is it fixed?"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid import Measurement, Scene, identify
from bcid.app.cli import main
from bcid.forms.forward import Forward
from bcid.forms.model import Model, check_physics
from bcid.forms.set_tangent import SetTangents
from bcid.forms.simulate import simulate
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.scene.parts import Level, Region

COUNT = 4


@pytest.fixture(scope="module")
def block(project: Path) -> Scene:
    """A block with markers on its top and its sides, which may be held at its foot, and at its bottom in two ways."""
    return Scene.read(project / "examples" / "scenes" / "block.toml", physics=check_physics)


def moved() -> list[Action]:
    """The jaw moves away from the foot, and up."""
    steps = np.arange(COUNT)
    way = np.linspace(0, 1, COUNT)[:, None] * [0.006, 0.0, 0.003]
    return [Action("1", steps, steps, "jaw", way, np.tile([1.0, 0.0, 0.0, 0.0], (COUNT, 1)))]


def seen(scene: Scene, anchors: set[str]) -> Measurement:
    """On a finer mesh."""
    return simulate(replace(scene, levels=(Level(2, 0.005),)), anchors, moved(), noise=0.05e-3, random_state=2)


@pytest.mark.parametrize(
    "anchors", [{"foot"}, {"foot", "slides"}, {"foot", "slides", "sticks"}], ids=["free", "sliding", "fixed"]
)
def test_a_face_is_free_slides_or_is_fixed(block: Scene, anchors: set[str]) -> None:
    found = identify(block, seen(block, anchors))
    assert set(found.anchored) == anchors
    assert found.probability > 0.95
    state = "anchored" if "sticks" in anchors else "free"
    assert f"{state} along x y" in found.summary


def test_without_the_axes_a_sliding_face_is_neither_free_nor_fixed(block: Scene) -> None:
    measured = seen(block, {"foot", "slides"})
    patches = {"foot": block.patches["foot"], "bottom": Region(("bottom",))}
    rms = []
    for scene, sets in (
        (block, [{"foot", "slides"}]),
        (replace(block, patches=patches, patch_axes={}), [{"foot"}, {"foot", "bottom"}]),
    ):
        forward = Forward(scene, 1)
        rms += [np.sqrt(np.mean((forward.predict(s, moved()).positions - measured.positions) ** 2)) for s in sets]
        forward.destroy()
    assert rms[0] < 0.06e-3
    assert min(rms[1:]) > 0.15e-3


def test_its_tangent_tells_other_sets_to_first_order(block: Scene) -> None:
    """Small steps: what every set shows about one that was followed is what it shows when it is followed itself."""
    small = [replace(action, translation=0.01 * action.translation) for action in moved()]
    forward = Forward(block, 0)
    whole = forward.predict({"foot"}, small, keep=True)
    steps = SetTangents(forward)
    assert {name: len(numbers) for name, numbers in steps.tractions.items()} == {"foot": 18, "slides": 6, "sticks": 12}
    forward.destroy()
    predictor = Predictor(block, simulate(block, {"foot"}, small, level=0, noise=0.0), MPI.COMM_SELF, level=0)
    about = predictor.predict(Model.of(block), {"foot"}, keep=True)
    told = predictor.moves(Model.of(block), {"foot"}, about, [frozenset({"foot", "slides"})])[0]
    other = predictor.predict(Model.of(block), {"foot", "slides"})
    change = other.positions - about.positions
    assert np.abs(told - change).max() < 0.2 * np.abs(change).max()
    assert np.abs(change).max() > 3e-6
    assert whole.complete
    predictor.destroy()


def test_scene_check_tells_along_what_a_patch_holds(block: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", "check", block.source]) == 0
    said = capsys.readouterr().out
    assert "holds along" in said
    assert "share" not in said


@pytest.mark.parametrize(
    ("along", "text"),
    [
        ('"w"', 'expected "x", "y" or "z", or a list of them, or "normal" or "tangent"'),
        ('["x", "normal"]', 'expected "x", "y" or "z"'),
    ],
)
def test_other_directions_are_refused(
    block: Scene, tmp_path: Path, along: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "block.toml"
    geometry = Path(block.source).parent / "../../meshes/geo/block.geo"
    text_of = Path(block.source).read_text(encoding="utf-8").replace("../../meshes/geo/block.geo", str(geometry))
    path.write_text(text_of.replace('along = "z"', f"along = {along}"), encoding="utf-8")
    assert main(["scene", "check", str(path)]) == 2
    assert text in capsys.readouterr().err
