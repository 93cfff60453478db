"""A gripper that gives, against springs in series worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from contract.test_effects import BAR, EXACT, YOUNG, model, move, scene_of
from numpy.typing import NDArray
from scipy.optimize import brentq
from verify.problems import box

from bcid.base.errors import InputError
from bcid.forms.forward import Forward
from bcid.forms.model import Term
from bcid.measurement import Action
from bcid.scene import Grasp, Region, Scene
from bcid.scene.rotation import from_vector, rotate

Array = NDArray[np.float64]
LENGTH, AREA = BAR[0], BAR[1] * BAR[2]
CENTRE = (0.1, 0.01, 0.01)
STIFFNESS = 2e5
# Without lateral contraction a bar that is pulled lengthens alone.
GIVING = model(poisson=0.0) + Term("grasp_compliance", {"stiffness": STIFFNESS})
END = {"a": (0.1, 0.01, 0.01), "b": (0.05, 0.01, 0.02)}


def scene() -> Scene:
    return scene_of(("x0",), "x1", CENTRE, fiducials=END)


def stress(stretch: float) -> float:
    """Of a neo-Hookean bar without lateral contraction, Pa."""
    return YOUNG / 2 * (stretch - 1 / stretch)


@pytest.mark.parametrize("poles", [1.0, -0.4], ids=["pulled", "pushed"])
def test_bar_and_gripper_are_springs_in_series(poles: float) -> None:
    forward = Forward(scene(), model=GIVING, settings=EXACT, mesh=box(BAR, (5, 1, 1)))
    led = poles * 0.04 * np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    pull = [move(led[:, None] * np.array([1.0, 0.0, 0.0]), "x1")]
    found = forward.detail(["x0"], pull, forward.predict(["x0"], pull, keep=True))
    stretch = [
        brentq(lambda s, far=far: stress(s) - STIFFNESS * (far - (s - 1) * LENGTH), 0.3, 2.0, xtol=1e-14) for far in led
    ]
    moved = (np.array(stretch) - 1) * LENGTH
    assert found.wrench is not None
    np.testing.assert_allclose(found.positions[:, 0, 0] - LENGTH, moved, atol=1e-10)
    np.testing.assert_allclose(found.positions[:, 1, 0] - LENGTH / 2, moved / 2, atol=1e-10)
    np.testing.assert_allclose(found.wrench[:, 0], AREA * STIFFNESS * (led - moved), atol=1e-9)
    np.testing.assert_allclose(found.wrench[:, 1:], 0.0, atol=1e-9)
    assert abs(moved[-1]) < 0.8 * abs(led[-1])
    forward.destroy()


def test_what_nothing_else_holds_follows_the_gripper() -> None:
    forward = Forward(scene(), model=GIVING, settings=EXACT, mesh=box(BAR, (5, 1, 1)))
    turned = np.array([from_vector(part * np.array([10.0, -20.0, 30.0])) for part in (0.0, 0.5, 1.0)])
    far = np.linspace(0, 1, 3)[:, None] * np.array([0.01, -0.02, 0.03])
    steps = np.arange(3)
    found = forward.predict([], [Action("1", steps, steps, "x1", far, turned)])
    places, centre = np.array(list(END.values())), np.array(CENTRE)
    expected = [centre + shift + rotate(turn, places - centre) for shift, turn in zip(far, turned, strict=True)]
    np.testing.assert_allclose(found.positions, expected, atol=1e-9)
    forward.destroy()


def test_a_gripper_that_gives_lags_most_where_most_pulls_back() -> None:
    """A bar resists a pull much more than being bent: along it the gripper lags, across it hardly."""
    forward = Forward(scene(), model=GIVING, settings=EXACT, mesh=box(BAR, (10, 2, 2)))
    lag = []
    for way in np.eye(3)[:2]:
        found = forward.predict(["x0"], [move(np.array([0.0, 0.005])[:, None] * way, "x1")])
        lag.append(0.005 - (found.positions[-1, 0] - np.array(CENTRE)) @ way)
    assert lag[0] > 10 * lag[1] > 0
    forward.destroy()


def test_its_work_is_all_that_body_and_springs_hold() -> None:
    """By the trapezoidal rule over many steps, from the wrench, and as a jump to another state is told by it."""
    forward = Forward(scene(), model=GIVING, settings=EXACT, mesh=box(BAR, (5, 1, 1)))
    way = np.linspace(0, 1, 41)[:, None] * np.array([0.02, 0.01, 0.0])
    forces, energies, applied = [], [], []

    def look(_frame: int, pose: object) -> None:
        forces.append(forward.equilibrium.wrench(pose)[:3])  # type: ignore[arg-type]
        energies.append(forward.equilibrium.energy())
        applied.append(forward.equilibrium.applied())

    forward.predict(["x0"], [move(way, "x1")], look=look)
    pulled = np.array(forces)
    work = float(((pulled[1:] + pulled[:-1]) / 2 * np.diff(way, axis=0)).sum())
    assert energies[-1] - energies[0] == pytest.approx(work, rel=1e-3)
    put_in = sum(0.5 * float((a[0] + b[0]) @ (b[1] - a[1])) for a, b in pairwise(applied))
    assert put_in == pytest.approx(work, rel=1e-6)
    forward.destroy()


def test_springs_need_a_surface() -> None:
    mesh = box(BAR, (5, 1, 1))
    mesh = replace(mesh, groups={**mesh.groups, "edge": np.array([[0, 1]])})
    line = Grasp(Region(groups=("edge",)), CENTRE)
    forward = Forward(replace(scene(), grasps={**scene().grasps, "line": line}), model=GIVING, mesh=mesh)
    with pytest.raises(InputError, match="grasp 'line' is not a surface: no springs can be spread over it"):
        forward.equilibrium.hold({"x0"}, "line")
    forward.destroy()
    with pytest.raises(InputError, match="grasp_compliance: no grasp of the scene is a surface"):
        Forward(replace(scene(), grasps={"line": line}), model=GIVING, mesh=mesh)


def test_the_tangent_at_rest_is_that_of_the_grasp_in_use() -> None:
    """It is remembered, but for what is held alike."""
    both = replace(scene(), grasps={**scene().grasps, "y1": Grasp(Region(("y1",)), CENTRE)})
    found = []
    for before in ("", "x1"):
        forward = Forward(both, model=GIVING, mesh=box(BAR, (5, 1, 1)))
        for grasp in (before, "y1"):
            forward.equilibrium.hold({"x0"}, grasp)
            forward.equilibrium.verify()
        found.append(forward.equilibrium.tangent.copied().toarray())
        forward.destroy()
    np.testing.assert_allclose(*found, atol=1e-12 * np.abs(found[0]).max())


def test_a_sliding_grip_leads_along_the_normal_alone() -> None:
    """A compressible bar that is stretched evenly: its end gets thinner in the grip, and a pull across it does nothing."""
    parts = replace(model(poisson=0.3), rollers=(("x0", 0), ("y0", 1), ("z0", 2)))
    sliding = parts + Term("sliding_grip", {"across": 0.0})
    forward = Forward(scene(), model=sliding, settings=EXACT, mesh=box(BAR, (5, 2, 2)))
    led = np.array([0.0, 0.01, 0.02])[:, None] * np.array([1.0, 0.4, -0.3])
    found = forward.detail([], [move(led, "x1")], forward.predict([], [move(led, "x1")], keep=True))
    moved = found.positions[-1] - np.array(list(END.values()))
    np.testing.assert_allclose(moved[0, 0], 0.02, atol=1e-6)
    np.testing.assert_allclose(moved[1, 0], 0.01, atol=1e-6)
    assert moved[0, 1] < -2e-4
    np.testing.assert_allclose(moved[:, 2] / [0.01, 0.02], moved[0, 1] / 0.01, atol=1e-9)
    assert found.wrench is not None
    np.testing.assert_allclose(found.wrench[-1, 1:3], 0.0, atol=1e-9)
    assert found.wrench[-1, 0] > 0
    forward.destroy()
