"""Published stereo images of a rubber strip (DuoDIC): its calibration is found again from its corners."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bcid.report.calibration import calibration_figure
from bcid.vision.calibrate import calibrate
from bcid.vision.calibration_job import numbers, summary
from bcid.vision.camera import Camera, Cameras
from bcid.vision.corners import read_corners
from bcid.vision.triangulate import triangulate

SIZE = (2448, 2048)


@pytest.fixture(scope="module")
def corners(real_data: Callable[[str], Path]) -> Path:
    return real_data("duodic_rubber") / "checkerboard_corners.csv.gz"


def test_the_published_calibration_is_found(corners: Path) -> None:
    """With the published model of the lens: two radial coefficients. Pixels are counted from 1 there."""
    published = json.loads((corners.parent / "stereo_calibration.json").read_text())
    found = calibrate(read_corners(corners, first=1), SIZE, distortion=2)
    assert len(found.used) == 37
    assert found.left_out == found.turned == ()
    cameras = found.cameras
    for camera, side in ((cameras.left, "cam1"), (cameras.right, "cam2")):
        matrix = np.array(published[side]["K"])
        matrix[:2, 2] -= 1
        np.testing.assert_allclose(camera.matrix, matrix, atol=0.05)
        for value, stated, near in zip(camera.distortion, published[side]["radial"], (2e-4, 5e-3), strict=False):
            assert value == pytest.approx(stated, abs=near)
        np.testing.assert_array_equal(camera.distortion[2:], 0)
    np.testing.assert_allclose(cameras.rotation, published["R_cam1_to_cam2"], atol=2e-5)
    np.testing.assert_allclose(cameras.translation * 1e3, published["t_cam1_to_cam2_mm"], atol=5e-3)
    assert cameras.baseline * 1e3 == pytest.approx(160.426, abs=1e-3)
    assert found.error == pytest.approx(0.587, abs=5e-4)


def test_the_steps_of_a_stage_are_measured(real_data: Callable[[str], Path]) -> None:
    """A speckled cylinder at 15 places, 0.2 mm apart. Published: 1.3 ± 1.1 µm for 3475 points, of which every fourth is here."""
    folder = real_data("duodic_rubber")
    table = np.genfromtxt(folder / "rbm_points.csv.gz", delimiter=",", names=True)
    left, right = (np.column_stack([table[f"{axis}{n}_px"] for axis in "uv"]) - 1 for n in (1, 2))
    places = triangulate(published_cameras(folder), left, right).positions
    states, points = (table[name].astype(int) for name in ("state", "point"))
    everywhere = np.flatnonzero(np.bincount(points) == states.max() + 1)
    assert len(everywhere) == 869
    kept = np.isin(points, everywhere)
    order = np.lexsort((points[kept], states[kept]))
    track = places[kept][order].reshape(states.max() + 1, len(everywhere), 3)
    stage = np.unique(table["stage_mm"]) * 1e-3
    error = np.abs(np.linalg.norm(track - track[0], axis=2) - stage[:, None])[1:]
    assert error.mean() == pytest.approx(1.72e-6, abs=0.02e-6)
    assert error.std() == pytest.approx(1.10e-6, abs=0.02e-6)


def published_cameras(folder: Path) -> Cameras:
    """The published calibration, with pixels counted from 0."""
    values = json.loads((folder / "stereo_calibration.json").read_text())
    sides = []
    for name in ("cam1", "cam2"):
        matrix = np.array(values[name]["K"])
        matrix[:2, 2] -= 1
        sides.append(Camera(matrix, np.array([*values[name]["radial"], 0.0, 0.0]), SIZE))
    return Cameras(*sides, np.array(values["R_cam1_to_cam2"]), np.array(values["t_cam1_to_cam2_mm"]) * 1e-3)


def test_what_is_stated_covers_another_model_of_the_lens(corners: Path) -> None:
    """The error falls from 0.587 to 0.506 px with tangential coefficients, and focal lengths change by less than is stated."""
    pairs = read_corners(corners, first=1)
    radial, full = (calibrate(pairs, SIZE, distortion=count) for count in (2, 4))
    assert full.error == pytest.approx(0.506, abs=5e-4)
    for side in ("left", "right"):
        change = getattr(full.cameras, side).focal - getattr(radial.cameras, side).focal
        assert abs(change) > 15
        assert abs(change) < 3 * min(c.deviations[f"{side}.fx"] for c in (radial, full))


def test_the_summary_says_so_and_it_can_be_drawn(corners: Path) -> None:
    found = calibrate(read_corners(corners, first=1), SIZE)
    assert summary(found).startswith("Calibration of two cameras: good\n")
    assert found.cameras.baseline == pytest.approx(0.1604, abs=2e-4)
    assert len(calibration_figure(json.loads(json.dumps(numbers(found), allow_nan=False))).axes) == 4
