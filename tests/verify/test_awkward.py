"""Measurements that are wrong in ways that happen: the anchors are right or open, never wrong and certain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from bcid import Measurement, Scene
from bcid.base.options import IdentifyOptions
from bcid.forms.model import check_physics
from bcid.forms.scene_errors import grip_term
from bcid.forms.simulate import simulate
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Action
from bcid.scene import Level
from bcid.search.answer.identification import Identification
from bcid.search.identify import identify

Array = NDArray[np.float64]
PATCHES = ("1", "2", "3", "7")
ANCHORED = ("1", "3")
NOISE, STEPS = 0.2e-3, 5
TRUE_LEVEL = 2
MARKER = 5


@pytest.fixture(scope="module")
def eight(project: Path) -> Scene:
    """With all of its patches."""
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    levels = tuple(Level(2, size) for size in (0.05, 0.025, 0.0125))
    return replace(scene, levels=levels, noise_sigma=NOISE)


@pytest.fixture(scope="module")
def slab(eight: Scene) -> Scene:
    """Four patches have 16 sets: what is wrong with a measurement shows as well as with eight."""
    return replace(eight, patches={name: eight.patches[name] for name in PATCHES})


def pulls(off: float = 0.0) -> list[Action]:
    """Three pulls by 10 mm, at another grasp each; the gripper is `off` m to a side of where it is reported."""
    drive = grip_term().effect.drive
    assert drive is not None
    unturned, steps = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1)), np.arange(STEPS)
    found = []
    for number, (grasp, way) in enumerate({"I": (1, 0, 0), "II": (0, 1, 0), "III": (1, 0, -1)}.items()):
        path = 0.0025 * steps[:, None] * np.array(way, float)
        action = Action(str(number + 1), number * STEPS + steps, steps, grasp, path, unturned)
        found.append(
            drive(action, dict.fromkeys(("x", "rx", "ry", "rz"), 0.0) | {"y": 0.0, "z": off}) if off else action
        )
    return found


def seen(slab: Scene, off: float = 0.0, noise: float = NOISE) -> Measurement:
    """What is measured, with the motions that are reported."""
    reported = simulate(slab, ANCHORED, pulls(), level=0, noise=0.0)
    true = simulate(slab, ANCHORED, pulls(off), level=TRUE_LEVEL, noise=noise)
    data = reported.data.copy(deep=True)
    data["position"] = (data["position"].dims, true.positions)
    return replace(reported, data=data, noise_sigma=NOISE if noise else None)


def changed(measurement: Measurement, change: Callable[[Array], None]) -> Measurement:
    """With other positions (frames, fiducials, 3), m."""
    data = measurement.data.copy(deep=True)
    positions = measurement.positions.copy()
    change(positions)
    data["position"] = (data["position"].dims, positions)
    return replace(measurement, data=data)


def six(positions: Array) -> None:
    positions[:, 6:] = np.nan


def gaps(positions: Array) -> None:
    positions[np.random.default_rng(3).random(positions.shape[:2]) < 0.2] = np.nan


def misplaced(positions: Array) -> None:
    positions[:, MARKER, 0] += 20e-3


def found(scene: Scene, measurement: Measurement) -> Identification:
    options = IdentifyOptions(level=1)
    return identify(scene, measurement, options=options)


def test_nothing_is_wrong(slab: Scene) -> None:
    identified = found(slab, seen(slab))
    assert identified.anchored == ANCHORED
    assert identified.probability > THRESHOLDS.credible
    assert identified.adequate


AWKWARD: dict[str, Callable[[Scene], tuple[Scene, Measurement]]] = {
    "six markers": lambda slab: (slab, changed(seen(slab), six)),
    "a fifth of all positions is missing": lambda slab: (slab, changed(seen(slab), gaps)),
    "the gripper is 3 mm from where it is reported": lambda slab: (slab, seen(slab, off=3e-3)),
    "one marker is wrong by 20 mm": lambda slab: (slab, changed(seen(slab), misplaced)),
    "no noise, and none is stated": lambda slab: (replace(slab, noise_sigma=None), seen(slab, noise=0.0)),
    "Poisson's ratio is wrong by 0.1": lambda slab: (softer(slab), seen(slab)),
}


def test_identify_all_markers_move_alike_no_set_is_certain(slab: Scene) -> None:
    def alike(positions: Array) -> None:
        """Every marker is displaced as all of them are on average."""
        moved = positions - positions[:1]
        positions[:] = positions[:1] + moved.mean(axis=1, keepdims=True)

    identified = found(slab, changed(seen(slab), alike))

    # A body that nothing holds moves with all markers alike.
    assert identified.probability < THRESHOLDS.credible or not identified.anchored
    assert identified.discrepancy_probability is not None
    assert identified.discrepancy_probability > THRESHOLDS.credible


def softer(slab: Scene) -> Scene:
    return replace(slab, material=replace(slab.material, values=slab.material.values | {"poisson": 0.25}))


@pytest.mark.parametrize("case", AWKWARD)
def test_it_is_right_or_open(slab: Scene, case: str) -> None:
    identified = found(*AWKWARD[case](slab))

    assert identified.anchored == ANCHORED or identified.probability < THRESHOLDS.credible
