"""Recordings of many frames: some are compared, and the others say whether the model shows what it was not compared with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from bcid.forms.simulate import recorded
from bcid.measurement import Action, Measurement
from bcid.measurement.compared import MOST_STEPS, LeftOut
from bcid.scene import Scene
from bcid.search.answer.identification_job import left_out_row
from bcid.search.answer.source import fitting

Array = NDArray[np.float64]
STEPS = 200
NOISE = 3e-4


@pytest.fixture(scope="module")
def slab() -> Scene:
    return Scene.read(Path(__file__).resolve().parents[2] / "examples/scenes/slab.toml")


def moved(scene: Scene, steps: Array, way: float) -> Array:
    """A motion that bends back and forth, shape (frames, fiducials, 3), m."""
    part = steps / STEPS
    along = np.stack([np.sin(3 * part), part**2, np.cos(5 * part) - 1], axis=-1)
    return np.asarray(scene.rest + way * along[:, None] * scene.rest[:, :1] / scene.rest[:, 0].max())


def made(scene: Scene, way: float = 8e-3) -> Measurement:
    """A long action and a short one."""
    actions, first = [], 0
    for name, count in (("long", STEPS + 1), ("short", 11)):
        steps = np.arange(count)
        pull = way * (steps / STEPS)[:, None] * np.array([1.0, 0.0, 0.0])
        still = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
        actions.append(Action(name, first + steps, steps, "II", pull, still))
        first += count
    positions = np.concatenate([moved(scene, action.steps, way) for action in actions])
    return recorded(scene, actions, positions, NOISE, np.random.default_rng(1))


def test_some_frames_are_compared_and_the_others_are_a_test(slab: Scene) -> None:
    whole = made(slab)
    scene, measurement = fitting(slab, whole, MPI.COMM_SELF)
    assert [len(action) for action in measurement.actions] == [MOST_STEPS + 1, 11]
    assert measurement.actions[0].steps[[0, -1]].tolist() == [0, STEPS]
    assert np.ptp(np.diff(measurement.actions[0].steps)) <= 1
    assert measurement.left_out is not None
    assert measurement.left_out.sizes["frame"] == STEPS - MOST_STEPS
    predicted = np.concatenate([moved(slab, action.steps, 8e-3) for action in measurement.actions])
    # Two rows more, as of a force and a torque.
    rows = np.concatenate([predicted, np.zeros((len(predicted), 2, 3))], axis=1)
    test = LeftOut.of(scene, measurement, rows)
    assert test is not None
    assert test.frames == STEPS - MOST_STEPS
    assert test.rms == pytest.approx(NOISE, rel=0.05)
    assert test.compared == pytest.approx(NOISE, rel=0.05)
    row = left_out_row(test)
    assert row is not None
    assert row.scaled(1e3).text.startswith("140 more frames were not compared")
    off = LeftOut.of(scene, measurement, rows + 1e-3)
    assert off is not None
    assert off.rms == pytest.approx(np.hypot(NOISE, 1e-3), rel=0.05)


def test_a_fiducial_that_is_not_compared_is_no_test(slab: Scene) -> None:
    scene, measurement = fitting(slab, made(slab), MPI.COMM_SELF)
    predicted = np.concatenate([moved(slab, action.steps, 8e-3) for action in measurement.actions])
    predicted[:, 3] += 0.1
    name = slab.fiducial_names[3]
    test = LeftOut.of(scene, measurement.without([name]), predicted)
    assert test is not None
    assert test.rms == pytest.approx(NOISE, rel=0.05)


def test_short_recordings_stay_whole(slab: Scene) -> None:
    short = made(slab).data.isel(frame=slice(0, MOST_STEPS + 1))
    whole = replace(made(slab), data=short)
    scene, measurement = fitting(slab, whole, MPI.COMM_SELF)
    assert measurement.left_out is None
    assert len(measurement.actions[0]) == MOST_STEPS + 1
    assert LeftOut.of(scene, measurement, measurement.positions) is None
