"""Published stereo images of a rubber strip (DuoDIC): its calibration is found again from its corners."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from bcid.report.calibration_picture import calibration_figure
from bcid.vision.calibrate import calibrate
from bcid.vision.calibrate_run import numbers, summary
from bcid.vision.camera import Cameras
from bcid.vision.corners import read_corners
from bcid.vision.triangulate import linear

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


def test_the_calibration_as_matlab_saves_it_places_the_published_points(corners: Path, tmp_path: Path) -> None:
    """DuoDIC's own triangulation, in MATLAB, of 8698 points on the rubber; its pixels are counted from 1."""
    published = json.loads((corners.parent / "stereo_calibration.json").read_text())
    tree: dict[str, Any] = {
        f"CameraParameters{n}": {
            "IntrinsicMatrix": np.array(published[f"cam{n}"]["K"]).T,
            "RadialDistortion": np.array(published[f"cam{n}"]["radial"]),
            "TangentialDistortion": np.zeros(2),
            "ImageSize": np.array(published[f"cam{n}"]["image_size_rows_cols"]),
            "WorldUnits": "mm",
        }
        for n in (1, 2)
    }
    tree["RotationOfCamera2"] = np.array(published["R_cam1_to_cam2"]).T
    tree["TranslationOfCamera2"] = np.array(published["t_cam1_to_cam2_mm"])
    savemat(tmp_path / "stereo.mat", {"stereoParams": tree})
    cameras = Cameras.read(tmp_path / "stereo.mat")
    assert cameras.left.size == SIZE
    table = np.genfromtxt(corners.parent / "uniaxial_points.csv.gz", delimiter=",", names=True)
    left, right = (np.column_stack([table[f"u{n}_px"], table[f"v{n}_px"]]) - 1 for n in (1, 2))
    points = np.column_stack([table[f"{axis}_mm"] for axis in "XYZ"])
    away = linear(replace(cameras, translation=cameras.translation * 1e3), left, right) - points
    assert np.isfinite(away).all(axis=1).sum() == 8698
    assert np.nanmax(np.abs(away)) < 7e-6
