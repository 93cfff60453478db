"""Calibration from an object whose points are known in space, picked in images: what is recovered, stated, and refused."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn import cameras
from numpy.typing import NDArray

from bcid.app.cli import main
from bcid.base.errors import InputError
from bcid.report.export import draw_pictures
from bcid.vision.calibrate import calibrate
from bcid.vision.camera import Cameras
from bcid.vision.corners import Corners
from bcid.vision.first_guess import first_guess, resect
from bcid.vision.known_points import KnownPoints
from bcid.vision.register import rigid
from bcid.vision.triangulate import triangulate

Array = NDArray[np.float64]

SIZE = (1280, 1024)
# A corner of a room, 30 points on each of its three walls of 63 mm; right-handed.
_GRID = np.array([(a, b) for a in range(7, 63, 11) for b in range(7, 64, 14)]) * 1e-3
OBJECT = np.vstack([np.insert(_GRID, axis, 0, axis=1) for axis in range(3)])
NAMES = [f"p{i + 1}" for i in range(len(OBJECT))]


def turn(x: float, y: float, z: float) -> Array:
    return np.asarray(cv2.Rodrigues(np.array([x, y, z]))[0])


def shown(count: int, noise: float, seed: int = 0, points: Array = OBJECT, tilt: float = 0.3) -> list[Corners]:
    """The object in the middle of what both cameras see, looked at from its open side, turned at random."""
    rng = np.random.default_rng(seed)
    # Its diagonal against the view.
    diagonal = turn(0, 0, 0.2) @ turn(np.radians(180 - 54.7), 0, 0) @ turn(0, 0, np.radians(-135))
    found = []
    for number in range(count):
        way = turn(*rng.uniform(-tilt, tilt, 3)) @ diagonal
        seen = (points - points.mean(axis=0)) @ way.T + [0, 0, 0.3] + rng.uniform(-0.01, 0.01, 3)
        left, right = (p + rng.normal(0, noise, p.shape) for p in map(np.asarray, cameras().project(seen)))
        found.append(Corners(number, points, left, right, tuple(NAMES[: len(points)])))
    return found


def away(found: Cameras) -> float:
    """RMS error, m, of points that the true cameras saw and those that were found place, up to a rigid motion."""
    places = np.random.default_rng(1).uniform([-0.04, -0.03, 0.27], [0.04, 0.03, 0.33], (200, 3))
    measured = triangulate(found, *cameras().project(places)).positions
    rotation, translation, _ = rigid(measured, places)
    return float(np.sqrt(np.mean((measured @ rotation.T + translation - places) ** 2)))


def test_one_view_of_a_solid_object_tells_both_cameras() -> None:
    found = calibrate(shown(1, 0.0), SIZE)
    assert away(found.cameras) < 1e-9
    assert found.cameras.left.distortion == pytest.approx(cameras().left.distortion, abs=1e-7)
    assert not found.flat
    assert found.verdict == "good"


def test_resection_is_exact_without_noise() -> None:
    pair = replace(shown(1, 0.0)[0])
    pixels = (
        np.column_stack([OBJECT, np.ones(len(OBJECT))])
        @ np.array([[2000, 10, 700, 300], [5, 2100, 500, 250], [0.1, 0.2, 1, 0.3]]).T
    )
    matrix = resect(pair.board, pixels[:, :2] / pixels[:, 2:])
    again = np.column_stack([OBJECT, np.ones(len(OBJECT))]) @ matrix.T
    np.testing.assert_allclose(again[:, :2] / again[:, 2:], pixels[:, :2] / pixels[:, 2:], atol=1e-8)


@pytest.mark.parametrize("count", [1, 4, 12])
def test_standard_deviations_are_honest(count: int) -> None:
    scores = []
    for seed in range(20):
        found = calibrate(shown(count, 0.3, seed), SIZE)
        truth = cameras()
        row = [(found.cameras.baseline - truth.baseline) / found.deviations["baseline"]]
        for side in ("left", "right"):
            one, other = getattr(found.cameras, side), getattr(truth, side)
            for name, place in (("fx", (0, 0)), ("fy", (1, 1)), ("cx", (0, 2)), ("cy", (1, 2))):
                row.append((one.matrix[place] - other.matrix[place]) / found.deviations[f"{side}.{name}"])
        scores.append(row)
        assert found.error == pytest.approx(0.3 * 2**0.5, rel=0.15)
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.3)


def test_a_flat_object_in_any_plane_is_a_board() -> None:
    """Its points lie on the wall x = 0, or nearly so: measured, each is off by some 0.1 mm."""
    wall = OBJECT[:30]
    rough = wall + np.random.default_rng(2).normal(0, 1e-4, wall.shape)
    for points, flat in ((wall, True), (rough, False)):
        found = calibrate(shown(8, 0.0, points=points, tilt=0.6), SIZE)
        assert away(found.cameras) < 1e-9
        assert found.flat == flat
    with pytest.raises(InputError, match="at least 3 are needed"):
        calibrate(shown(1, 0.0, points=rough), SIZE)


def test_names_are_believed() -> None:
    """A chessboard may be counted from its other end; a point with a name is that point, and the pair is wrong."""
    pairs = shown(8, 0.0, points=_GRID @ np.eye(2, 3), tilt=0.6)
    pairs[3] = replace(pairs[3], right=pairs[3].right[::-1])
    found = calibrate(pairs, SIZE)
    assert found.turned == ()
    assert not found.usable
    assert "of pair 3" in str(found.worst_point)
    assert calibrate([replace(c, names=()) for c in pairs], SIZE).turned == (3,)


@pytest.mark.parametrize("points", [OBJECT, OBJECT[:30]])
def test_the_start_is_near(points: Array) -> None:
    """Focal lengths of 2260 and 2248 px, less a few percent for the lens."""
    state, _, _ = first_guess(shown(4, 0.1, points=points, tilt=0.6), (SIZE, SIZE), 4)
    np.testing.assert_allclose(state.inner[:, 0], [2260, 2248], rtol=0.04)


def test_what_cannot_calibrate_is_told() -> None:
    pair = shown(1, 0.1)[0]
    upward = replace(pair, left=pair.left * [1, -1] + [0, 1023], right=pair.right * [1, -1] + [0, 1023])
    with pytest.raises(InputError, match=r"as in a mirror; v must count down .* right-handed"):
        calibrate([upward], SIZE)
    with pytest.raises(InputError, match="as in a mirror"):
        calibrate([replace(pair, board=pair.board * [1, 1, -1])], SIZE)
    few = [0, 13, 29, 35, 59, 75, 85]
    some = Corners(0, pair.board[few], pair.left[few], pair.right[few])
    with pytest.raises(InputError, match=r"28 pixel coordinates are not enough for 28 unknowns; .*--distortion 0"):
        calibrate([some], SIZE)
    assert calibrate([some], SIZE, distortion=0).cameras.baseline == pytest.approx(cameras().baseline, rel=0.2)
    # One point that was mistaken for its neighbour is named.
    pair.left[7] += [0, 60]
    found = calibrate([pair], SIZE)
    assert not found.usable
    assert "of point p8 in the left image of pair 0" in str(found.worst_point)
    assert "point p8" in found.findings[0].advice


def tables(folder: Path, pairs: list[Corners], unit: str = "mm", first: float = 1.0) -> list[str]:
    """Files of the points and of the pixels, as somebody at a bench would write them; arguments of the command."""
    scale = {"mm": 1e3, "m": 1.0}[unit]
    rows = [f"{n},{x * scale:.9g},{y * scale:.9g},{z * scale:.9g}" for n, (x, y, z) in zip(NAMES, OBJECT, strict=True)]
    (folder / "object.csv").write_text(f"name,x_{unit},y_{unit},z_{unit}\n" + "\n".join(rows))
    lines = ["pose,name,u_left,v_left,u_right,v_right"]
    for c in pairs:
        for name, left, right in zip(c.names, c.left + first, c.right + first, strict=True):
            lines.append(f"{c.number},{name}," + ",".join(f"{value:.6f}" for value in (*left, *right)))
    # The right camera did not see the last one.
    lines[-1] = ",".join(lines[-1].split(",")[:4]) + ",,"
    (folder / "picked.csv").write_text("\n".join(lines))
    return ["--board", str(folder / "object.csv"), "--picked", str(folder / "picked.csv")]


def test_from_tables_to_a_run_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = tables(tmp_path, shown(2, 0.1))
    read = KnownPoints.read(tmp_path / "object.csv").picked(tmp_path / "picked.csv", first=1.0)[0]
    np.testing.assert_allclose(read.left, shown(2, 0.1)[0].left, atol=1e-6)
    run = tmp_path / "run"
    more = ["--image-size", "1280x1024", "--first-pixel", "1", "-o", str(run), "--quiet"]
    assert main(["calibrate", *told, *more]) == 0
    found = Cameras.read(run / "cameras.json")
    assert away(found) < 3e-5
    assert found.left.size == SIZE
    text = (run / "summary.txt").read_text()
    assert text.startswith("Calibration of two cameras: good\n")
    assert "over 179 corners of 2 pairs" in text
    assert "The largest residual is 0." in text
    assert "tilted" not in text
    assert cv2.imread(str(draw_pictures(run)[0])).shape[1] == 1800
    # What is missing is said, and nothing is written.
    other = ["-o", str(tmp_path / "other")]
    for arguments, words in (
        ([*told, *other], "--image-size 1280x1024"),
        ([*told, *other, "--image-size", "1280"], "expected width x height"),
        ([*told[:2], *other], "go together"),
        (["--board", "chessboard 10x7 10 mm", *other], "the images are missing"),
        (["--board", "chessboard 10x7 10 mm", *told[2:], *other], "go together"),
    ):
        assert main(["calibrate", *arguments]) == 2
        assert words in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("file", "text", "parts"),
    [
        ("object.csv", "", ["is empty"]),
        ("object.csv", "name,x,y,z\na,1,2,3\n", [":1: x, y, z: one unit", "x_mm, y_mm, z_mm"]),
        ("object.csv", "name,x_mm,y_mm\n", ["column z is missing"]),
        (
            "object.csv",
            "name,x_mm,y_mm,z_mm\na,1,2,3\na,1,2,3\nb,1,2\nc,1,,3\nd,?,1,2\n",
            [
                ":3: point a stands twice",
                ":4: has 3 values",
                ":5: point c: its place",
                ":6: x: expected a number",
                "'?'",
            ],
        ),
        ("picked.csv", "name,u_left,v_left,u_right\n", ["column v_right is missing"]),
        (
            "picked.csv",
            "pose,name,u_left,v_left,u_right,v_right\n0,p1,1,1,1,1\n0,p1,1,1,1,1\nx,p2,1,1,1,1\n1,P3,1,1,1,1\n0,p4,1,1e9,1,1",
            [
                ":3: point p1 of pose 0 stands twice",
                ":4: pose: expected",
                ":5: point 'P3'",
                "did you mean 'p3'",
                ":6: v_left",
            ],
        ),
    ],
)
def test_what_is_wrong_in_a_table_is_told_by_line(tmp_path: Path, file: str, text: str, parts: list[str]) -> None:
    tables(tmp_path, shown(1, 0.0))
    (tmp_path / file).write_text(text)
    with pytest.raises(InputError) as raised:
        KnownPoints.read(tmp_path / "object.csv").picked(tmp_path / "picked.csv")
    for part in parts:
        assert part in str(raised.value)
