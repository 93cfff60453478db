"""A patch that is attached on a part of its area is told from what else is soft near it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid.base.options import ExplainOptions
from bcid.forms.mesh.patch_frame import PatchFrame
from bcid.forms.mesh.patches import halves
from bcid.forms.model import check_physics
from bcid.forms.simulate import simulate
from bcid.measurement import Action, Measurement
from bcid.predict.predictor import Predictor
from bcid.scene import Level, Scene
from bcid.search.explain import explain

STEPS = 4


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    patches = {name: scene.patches[name] for name in "2347"}
    return replace(scene, patches=patches, levels=(Level(2, 0.02), Level(2, 0.012)), noise_sigma=0.1e-3)


@pytest.fixture(scope="module")
def measured(slab: Scene) -> Measurement:
    """Patch 3 is attached on one half of its area, of a finer mesh."""
    unturned, steps = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1)), np.arange(STEPS)
    ways = {"I": (12e-3, 0, 0), "II": (0, 8e-3, 6e-3)}
    actions = [
        Action(grasp, k * STEPS + steps, steps, grasp, steps[:, None] / (STEPS - 1) * np.array(way), unturned)
        for k, (grasp, way) in enumerate(ways.items())
    ]
    return simulate(halves(slab, "3"), {"3.1", "4"}, actions, level=1)


def test_a_patch_that_is_attached_in_part_is_named(slab: Scene, measured: Measurement) -> None:
    predictor = Predictor(slab, measured, MPI.COMM_SELF, level=0)
    found = explain(predictor, ExplainOptions(level=0, only=("partial_anchor", "inclusion", "soft_anchor")))
    predictor.destroy()
    assert (found.verdict, found.last.state.anchors) == ("partial_anchor", {"3", "4"})
    values = found.last.fitted.values
    # The upper half, along z, is not held.
    assert values["partial_anchor(3).angle"] == pytest.approx(90.0, abs=20.0)
    assert values["partial_anchor(3).border"] == pytest.approx(0.0, abs=0.25)


def test_axes_of_a_patch_do_not_depend_on_its_mesh() -> None:
    corners = np.array([[1.0, y, z] for y in (0.0, 2.0) for z in (3.0, 4.0)])
    frame = PatchFrame.of(corners)
    assert frame.centre == pytest.approx((1.0, 1.0, 3.5))
    assert frame.half == pytest.approx((1.0, 0.5))
    more = PatchFrame.of(np.vstack([corners, [[1.0, 0.1, 3.1], [1.0, 0.2, 3.2]]]))
    assert (*more.centre, *more.half) == pytest.approx((*frame.centre, *frame.half))
    assert np.array(more.axes) == pytest.approx(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), abs=1e-12)
    assert frame.plane((1.0, 2.0, 3.0)) == pytest.approx((1.0, -0.5))
