"""Calibrations of other programs: each file, written as that program writes it, gives the cameras that OpenCV projects with."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from bcid.app.cli import main
from bcid.base.errors import InputError
from bcid.vision.camera import Camera, Cameras
from bcid.vision.recording import Recording
from bcid.vision.triangulate import triangulate

Array = NDArray[np.float64]

SIZE = (1280, 1024)
LENS = np.array([-0.12, 0.08, 6e-4, -4e-4, 0.02])
# Where the left camera stands in the frame of the calibration object, whose origin both see.
POSE = (cv2.Rodrigues(np.array([2.0, 0.3, -0.4]))[0], np.array([-0.03, 0.02, 0.45]))


def rig(skew: float = 1.7, lens: Array = LENS) -> Cameras:
    left = Camera(np.array([[2260, skew, 641.3], [0, 2255, 508.7], [0, 0, 1]]), lens, SIZE)
    right = Camera(np.array([[2248, -skew, 633.1], [0, 2251, 517.2], [0, 0, 1]]), lens * [0.8, 1.2, -1, 1, 0], SIZE)
    turn = cv2.Rodrigues(np.array([0.02, 0.5, 0.01]))[0]
    return Cameras(left, right, turn, np.array([-0.2, 0.003, 0.05]))


def places() -> Array:
    """In the left camera's frame, m."""
    return np.random.default_rng(0).uniform([-0.08, -0.06, 0.4], [0.08, 0.06, 0.5], (40, 3))


def by_opencv(cameras: Cameras, points: Array) -> Array:
    """Pixels (2, n, 2): distorted directions are OpenCV's, the affine map of the sensor is written out."""
    seen = []
    for camera, turn, shift in (
        (cameras.left, np.eye(3), np.zeros(3)),
        (cameras.right, cameras.rotation, cameras.translation),
    ):
        x, y = cv2.projectPoints(points, cv2.Rodrigues(turn)[0], shift, np.eye(3), camera.distortion)[0][:, 0].T
        (fx, s, cx), (_, fy, cy) = camera.matrix[:2]
        seen.append(np.column_stack([fx * x + s * y + cx, fy * y + cy]))
    return np.array(seen)


def same(found: Cameras, truth: Cameras, atol: float = 1e-6) -> None:
    np.testing.assert_allclose(np.array(found.project(places())), by_opencv(truth, places()), rtol=0, atol=atol)
    assert found.baseline == pytest.approx(truth.baseline, rel=1e-9)


# -- skew
# ------------------------------------------------------------------------------------------------------------------


def test_skew_counts_in_both_directions() -> None:
    """A sensor with a skew of 40 px behind a lens: projection is OpenCV's, undistortion its inverse, triangulation exact."""
    cameras = rig(40.0)
    same(cameras, cameras, 1e-9)
    pixels = cameras.left.project(places())
    np.testing.assert_allclose(cameras.left.undistort(pixels), places()[:, :2] / places()[:, 2:], rtol=0, atol=1e-13)
    np.testing.assert_allclose(triangulate(cameras, *cameras.project(places())).positions, places(), atol=1e-12)
    assert np.abs(pixels - replace(cameras.left, matrix=rig(0.0).left.matrix).project(places())).max() > 3


# -- MATLAB
# ------------------------------------------------------------------------------------------------------------------


def parameters(camera: Camera, newer: bool) -> dict[str, Any]:
    """What toStruct gives of a camera: pixels from 1; older releases have matrices for row vectors."""
    matrix = camera.matrix + np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
    k1, k2, p1, p2, k3 = camera.distortion
    return {
        "RadialDistortion": np.array([k1, k2, k3]) if k3 else np.array([k1, k2]),
        "TangentialDistortion": np.array([p1, p2]),
        "ImageSize": np.array(SIZE[::-1], dtype=float),
        "WorldUnits": "millimeters" if newer else "mm",
        "EstimateSkew": True,
        "WorldPoints": np.zeros((54, 2)),
    } | ({"K": matrix} if newer else {"IntrinsicMatrix": matrix.T})


def stereo_struct(cameras: Cameras, newer: bool) -> dict[str, Any]:
    both = {f"CameraParameters{n}": parameters(c, newer) for n, c in ((1, cameras.left), (2, cameras.right))}
    shift = cameras.translation * 1e3
    if newer:
        return both | {"PoseCamera2": {"Dimensionality": 3.0, "R": cameras.rotation, "Translation": shift}}
    return both | {"RotationOfCamera2": cameras.rotation.T, "TranslationOfCamera2": shift, "Version": {"Release": "x"}}


def save_v73(file: Path, tree: dict[str, Any]) -> None:
    """A MAT file of version 7.3: HDF5 behind 512 bytes, every array the other way round."""

    def write(group: Any, name: str, value: Any) -> None:
        if isinstance(value, dict):
            part = group.create_group(name)
            part.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, one in value.items():
                write(part, key, one)
            return
        text = isinstance(value, str)
        array = (
            np.array([[ord(c)] for c in value], dtype=np.uint16) if text else np.atleast_2d(np.asarray(value, float)).T
        )
        group.create_dataset(name, data=array).attrs["MATLAB_class"] = np.bytes_("char" if text else "double")

    with h5py.File(file, "w", userblock_size=512) as stream:
        for key, one in tree.items():
            write(stream, key, one)
    with file.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize(("save", "newer"), [(savemat, False), (save_v73, True)])
def test_stereo_parameters_of_matlab(tmp_path: Path, save: Callable[..., None], newer: bool) -> None:
    """Saved with '-struct', and as a variable."""
    file, truth = tmp_path / "stereo.mat", rig()
    tree = stereo_struct(truth, newer)
    save(file, {"stereoParams": tree} if newer else tree)
    found = Cameras.read(file)
    same(found, truth)
    assert found.left.size == SIZE
    # A unit that contradicts the one in the file.
    with pytest.raises(InputError, match=r"length_unit: the file says 'mm', elsewhere 'm' is stated"):
        Cameras.read(file, "m")
    how = {"image_size": [1024, 1280], "first_pixel": 1}
    with pytest.raises(InputError, match=r"how MATLAB's stereoParameters counts pixels is known"):
        Cameras.read(file, **how)


def test_results_of_bouguets_toolbox(tmp_path: Path) -> None:
    file, truth = tmp_path / "Calib_Results_stereo.mat", rig()
    tree: dict[str, Any] = {"om": cv2.Rodrigues(truth.rotation)[0], "T": truth.translation[:, None] * 1e3}
    for side, camera in (("left", truth.left), ("right", truth.right)):
        (fx, skew, cx), (_, fy, cy) = camera.matrix[:2]
        tree |= {f"fc_{side}": np.array([[fx], [fy]]), f"cc_{side}": np.array([[cx], [cy]])}
        tree |= {f"alpha_c_{side}": skew / fx, f"kc_{side}": camera.distortion[:, None]}
    savemat(file, tree | {"nx": 1280.0, "ny": 1024.0})
    found = Cameras.read(file, "mm")
    same(found, truth)
    assert found.right.size == SIZE


# -- DLT coefficients and projections
# ------------------------------------------------------------------------------------------------------------------


def projections(cameras: Cameras) -> tuple[Array, Array]:
    """Matrices (3, 4) from the frame of the calibration object, mm, to pixels."""
    turn, place = POSE
    left = np.column_stack([turn, place * 1e3])
    right = np.column_stack([cameras.rotation @ turn, (cameras.rotation @ place + cameras.translation) * 1e3])
    return cameras.left.matrix @ left, cameras.right.matrix @ right


def coefficients(cameras: Cameras, first: int = 0, upward: bool = False) -> Array:
    """The eleven (11, 2) of each camera, by the linear equations of points that OpenCV projected (Abdel-Aziz & Karara)."""
    columns = []
    world = (places() - POSE[1]) @ POSE[0] * 1e3
    for pixels in by_opencv(cameras, places()):
        u, v = (pixels * [1, -1] + [0, SIZE[1] - 1] if upward else pixels).T + first
        nought, one = np.zeros_like(world), np.ones((len(world), 1))
        above = np.hstack([world, one, nought, 0 * one, -u[:, None] * world])
        below = np.hstack([nought, 0 * one, world, one, -v[:, None] * world])
        columns.append(np.linalg.lstsq(np.vstack([above, below]), np.concatenate([u, v]), rcond=None)[0])
    return np.array(columns).T


def pinholes() -> Cameras:
    return rig(1.7, np.zeros(5))


def csv(numbers: Array, comma: str = ",") -> str:
    return "\n".join(comma.join(f"{value:.17g}" for value in row) for row in numbers) + "\n"


def test_a_projection_is_taken_apart_as_opencv_does() -> None:
    from bcid.vision.calibrations.projections import decompose

    for matrix in projections(pinholes()):
        found = decompose(-3 * matrix)
        assert found is not None
        inner, turn, centre = cv2.decomposeProjectionMatrix(matrix)[:3]
        np.testing.assert_allclose(found[0], inner / inner[2, 2], atol=1e-8)
        np.testing.assert_allclose(found[1], turn, atol=1e-12)
        np.testing.assert_allclose(-found[1].T @ found[2], (centre[:3] / centre[3]).ravel(), rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "write", "how"),
    [
        ("dltcoefs.csv", lambda f, c: f.write_text(csv(coefficients(c))), {}),
        ("rows.csv", lambda f, c: f.write_text("camera;L1;L2\n" + csv(coefficients(c).T, ";")), {}),
        (
            "named.csv",
            lambda f, c: f.write_text(
                "L,cam1,cam2\n" + "".join(f"L{i + 1},{a:.17g},{b:.17g}\n" for i, (a, b) in enumerate(coefficients(c)))
            ),
            {},
        ),
        ("matlab.csv", lambda f, c: f.write_text(csv(coefficients(c, first=1))), {"first_pixel": 1}),
        (
            "upward.csv",
            lambda f, c: f.write_text(csv(coefficients(c, 1, True))),
            {"first_pixel": 1, "origin": "lower left", "image_size": [1280, 1024]},
        ),
        ("stacked.txt", lambda f, c: f.write_text(csv(np.vstack(projections(c)), " ")), {}),
        ("pair.npy", lambda f, c: np.save(f, np.array(projections(c))), {}),
        ("pair.json", lambda f, c: f.write_text(json.dumps({"P": [(-p).tolist() for p in projections(c)]})), {}),
        (
            "pair.toml",
            lambda f, c: f.write_text(
                "first_pixel = 1\n"
                + "".join(f"L{n} = {x.tolist()}\n" for n, x in zip("12", coefficients(c, 1).T, strict=True))
            ),
            {},
        ),
        ("pair.mat", lambda f, c: savemat(f, dict(zip(("P1", "P2"), projections(c), strict=True))), {}),
    ],
)
def test_projections_in_files(
    tmp_path: Path, name: str, write: Callable[[Path, Cameras], Any], how: dict[str, Any]
) -> None:
    """Used by a recording, which states what the file does not."""
    truth = pinholes()
    write(tmp_path / name, truth)
    lines = [
        'format = "bcid-recording/1"',
        f'cameras = "{name}"',
        'camera_length_unit = "mm"',
        'left = "l"',
        'right = "r"',
    ]
    lines += [f"camera_{key} = {json.dumps(value)}" for key, value in how.items()]
    file = tmp_path / "recording.toml"
    file.write_text("\n".join([*lines, "[beads]", 'diameter = "1 mm"']))
    same(Recording.read(file).cameras, truth)


def test_the_examples_of_the_documentation(tmp_path: Path) -> None:
    """Their numbers are of two cameras 155.3 mm apart at 30 degrees; the picked points have 0.1 px of noise."""
    page = (Path(__file__).resolve().parents[2] / "docs/vision.md").read_text(encoding="utf-8")
    for name, text in re.findall(r"^`([\w.]+)`:\n\n```text\n(.*?)```", page, re.MULTILINE | re.DOTALL):
        (tmp_path / name).write_text(text)
    how = re.search(r'```toml\n(cameras = "dltcoefs.csv".*?)```', page, re.DOTALL)
    assert how
    text = f'format = "bcid-recording/1"\n{how[1]}\nleft = "l"\nright = "r"\n[beads]\ndiameter = "1 mm"\n'
    (tmp_path / "recording.toml").write_text(text)
    found = Recording.read(tmp_path / "recording.toml").cameras
    assert found.baseline == pytest.approx(0.15529, abs=1e-5)
    assert found.angle == pytest.approx(30, abs=1e-3)
    assert found.left.matrix == pytest.approx(np.array([[2260, 0, 641.3], [0, 2255, 508.7], [0, 0, 1]]), abs=0.01)
    command = re.search(r"^    bcid (calibrate --board object.csv .*)$", page, re.MULTILINE)
    assert command
    words = [
        str(tmp_path / word) if word.endswith(".csv") or word == "cameras" else word for word in command[1].split()
    ]
    assert main([*words, "--quiet"]) == 0
    assert Cameras.read(tmp_path / "cameras/cameras.json").baseline == pytest.approx(0.15529, rel=0.02)


# -- what cannot be used
# ------------------------------------------------------------------------------------------------------------------


def broken(**change: Any) -> dict[str, Any]:
    tree = stereo_struct(rig(), False) | change
    return {name: value for name, value in tree.items() if value is not None}


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("s.mat", b"MATLAB 5.0 MAT-file", "is not a readable MAT file"),
        ("s.mat", {"a": np.zeros(3)}, r"holds a; an object of MATLAB .* toStruct\(stereoParams\)"),
        (
            "s.mat",
            broken(CameraParameters2=None, RotationOfCamera2=None),
            r"(?s)CameraParameters2: is missing, .*toStruct.*RotationOfCamera2 .*: is missing",
        ),
        ("s.mat", {"fc_left": np.ones(2), "R": np.eye(3)}, r"(?s)cc_left: expected 2 numbers.*fc_right.*T: expected"),
        ("s.npy", b"\x93NUMPY\x01\x00", "not a calibration file"),
        ("s.npy", b"\x93NUMPY\x01\x00\x10\x00{'descr': '<f8\0\0\0\n", "not a calibration file"),
        ("s.csv", "", "holds no numbers"),
        ("s.csv", "1,2\n3\n", r"s\.csv:2: has 1 numbers, the first row has 2"),
        ("s.csv", "1,2\n3,x\n", r"s\.csv:2: expected numbers with a decimal point, found 'x'"),
        ("s.csv", csv(np.ones((11, 4))), "holds 4 camera.*keep the two"),
        ("s.csv", csv(np.ones((3, 4))), "holds 1 camera.* of 3 x 4 numbers"),
        ("s.csv", csv(np.ones((16, 2))), "has 16 coefficients .*undistort"),
        ("s.csv", csv(np.ones((10, 2))), r"holds 1 camera\(s\) of 10 x 2 numbers"),
        ("s.csv", csv(np.ones((11, 2))), "camera at infinity"),
        ("s.csv", csv(coefficients(pinholes(), 0, True)), '(?s)mirrored.*origin = "lower left".*third column'),
        ("s.toml", "P1 = 3\nP2 = 4\n", r"(?s)left camera .*expected 3 x 4.*right camera"),
        # Matrices of rectified images say nothing of the images that were taken.
        (
            "s.json",
            json.dumps({"P1": 1, "P2": 2, "R": np.eye(3).tolist(), "T": [1, 0, 0]}),
            "matrix of the left camera",
        ),
        ("s.toml", 'origin = "top"\nP1 = 1\nP2 = 2', 'origin: expected "upper left" or "lower left"'),
    ],
)
def test_what_cannot_be_used_is_told(tmp_path: Path, name: str, content: Any, words: str) -> None:
    file = tmp_path / name
    if isinstance(content, dict):
        savemat(file, content)
    elif isinstance(content, bytes):
        file.write_bytes(content)
    else:
        file.write_text(content)
    with pytest.raises(InputError, match=words):
        Cameras.read(file, "mm")


def test_pixels_that_count_upwards_need_the_height(tmp_path: Path) -> None:
    file = tmp_path / "dlt.csv"
    file.write_text(csv(coefficients(pinholes())))
    with pytest.raises(InputError, match="image_size: pixels counted from the lower left need it"):
        Cameras.read(file, "mm", origin="lower left")
    with pytest.raises(InputError, match="it counts v down; leave origin away"):
        Cameras.read(file, "mm", origin="lower left", image_size=SIZE)
    with pytest.raises(InputError, match="length_unit: of the translation is not stated"):
        Cameras.read(file)


@pytest.mark.parametrize("name", ["c.yml", "c.xml"])
def test_nested_brackets_end_the_process_that_reads_and_not_this_one(tmp_path: Path, name: str) -> None:
    deep = "%YAML:1.0\n---\na: " + "[" * 60_000
    if name.endswith("xml"):
        deep = "<?xml version='1.0'?><opencv_storage>" + "<a>" * 60_000
    (tmp_path / name).write_text(deep, encoding="utf-8")
    with pytest.raises(InputError, match=rf"{name}: OpenCV cannot read it: "):
        Cameras.read(tmp_path / name)


@pytest.mark.parametrize("scale", [1e-150, 1e150])
def test_a_projection_of_any_scale_is_taken_apart(scale: float) -> None:
    from bcid.vision.calibrations.projections import decompose

    for whole, tiny in zip(projections(pinholes()), (scale * p for p in projections(pinholes())), strict=True):
        expected, found = decompose(whole), decompose(tiny)
        assert expected is not None
        assert found is not None
        for one, other in zip(expected, found, strict=True):
            np.testing.assert_allclose(other / np.abs(other).max(), one / np.abs(one).max(), atol=1e-12)
