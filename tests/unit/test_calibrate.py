"""Calibration: what is recovered from boards seen by known cameras, what is doubted, and what is refused."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.report.export import draw_pictures
from bcid.vision.board import Board
from bcid.vision.calibrate import angle_by_turn, calibrate, coverage
from bcid.vision.calibrate_run import numbers, run_calibration, summary
from bcid.vision.calibration import Calibration
from bcid.vision.camera import Camera, Cameras
from bcid.vision.corners import Corners, corners_in, read_corners

Array = NDArray[np.float64]

SIZE = (1280, 960)
BOARD = Board.parse("chessboard 10x7 10 mm")


def turn(x: float, y: float, z: float) -> Array:
    return np.asarray(cv2.Rodrigues(np.array([x, y, z]))[0])


def cameras(size: tuple[int, int] = SIZE, distorted: bool = True) -> Cameras:
    """Two cameras 15 cm apart that look at the same place, 0.45 m away."""
    matrices = np.array([[[1500, 0, 655], [0, 1510, 490], [0, 0, 1]], [[1480, 0, 630], [0, 1490, 500], [0, 0, 1]]])
    matrices = matrices * size[0] / SIZE[0]
    matrices[:, 2, 2] = 1
    lenses = np.array([[-0.12, 0.08, 6e-4, -4e-4], [-0.1, 0.05, -3e-4, 5e-4]]) * distorted
    left, right = (Camera(matrix, lens, size) for matrix, lens in zip(matrices, lenses, strict=True))
    return Cameras(left, right, turn(0.02, 0.3, 0.01), np.array([-0.15, 0.003, 0.02]))


def seen(
    count: int,
    noise: float,
    seed: int = 0,
    tilt: float = 0.5,
    wide: float = 0.1,
    board: Board = BOARD,
    by: Cameras | None = None,
) -> list[Corners]:
    """Corners of boards at random in front of the cameras, with noise in px."""
    random = np.random.default_rng(seed)
    by = by or cameras()
    found: list[Corners] = []
    while len(found) < count:
        points = (board.points - board.points.mean(axis=0)) @ turn(*random.uniform(-tilt, tilt, 3) * [1, 1, 0.6]).T
        points += [*random.uniform(-wide, wide, 2) * [1, 0.8], random.uniform(0.35, 0.5)]
        pixels = np.array(by.project(points))
        if pixels.min() < 0 or (pixels - by.left.size).max() > 0:
            continue
        left, right = pixels + random.normal(0, noise, pixels.shape)
        found.append(Corners(len(found), board.points, left, right))
    return found


def deviations(found: Calibration, truth: Cameras) -> dict[str, float]:
    """Errors in units of their stated standard deviations."""
    errors = {"baseline": found.cameras.baseline - truth.baseline, "angle": found.cameras.angle - truth.angle}
    for side in ("left", "right"):
        one, other = getattr(found.cameras, side), getattr(truth, side)
        for name, place in (("fx", (0, 0)), ("fy", (1, 1)), ("cx", (0, 2)), ("cy", (1, 2))):
            errors[f"{side}.{name}"] = one.matrix[place] - other.matrix[place]
        for name, value in zip(("k1", "k2", "p1", "p2"), one.distortion - other.distortion, strict=True):
            errors[f"{side}.{name}"] = value
    return {name: error / found.deviations[name] for name, error in errors.items()}


# -- from corners
# ------------------------------------------------------------------------------------------------------------------


def test_without_noise_the_cameras_are_recovered() -> None:
    truth = cameras()
    found = calibrate(seen(12, 0.0), SIZE)
    assert found.error < 1e-6
    np.testing.assert_allclose(found.cameras.left.matrix, truth.left.matrix, atol=1e-5)
    np.testing.assert_allclose(found.cameras.right.distortion, truth.right.distortion, atol=1e-7)
    np.testing.assert_allclose(found.cameras.rotation, truth.rotation, atol=1e-8)
    np.testing.assert_allclose(found.cameras.translation, truth.translation, atol=1e-8)
    assert found.verdict == "good"


@pytest.mark.parametrize("count", [8, 14])
def test_standard_deviations_are_honest(count: int) -> None:
    """Errors divided by what is stated are of order one: from the Jacobian (few pairs) and from the jackknife."""
    truth = cameras()
    scores = []
    for seed in range(20):
        found = calibrate(seen(count, 0.3, seed), SIZE)
        scores.append(list(deviations(found, truth).values()))
        assert found.deviations_from == ("Jacobian" if count < 10 else "jackknife over pairs")
        # The distance of two components, each of 0.3 px, less what the fit takes up.
        assert found.error == pytest.approx(0.3 * 2**0.5, rel=0.07)
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all((rms > 0.45) & (rms < 1.7)), rms
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.25)
    assert np.abs(scores[0]).max() < 3


def test_errors_that_pairs_have_in_common_are_not_taken_for_noise() -> None:
    """A board that is bent in each picture: the scatter of the residuals alone would promise too much."""
    pairs = []
    for c, bend in zip(seen(14, 0.02, 3), np.random.default_rng(0).normal(0, 1.0, 14), strict=True):
        x, y = (c.board[:, :2] - c.board[:, :2].mean(axis=0)).T / np.ptp(c.board[:, 0])
        shift = bend * np.column_stack([x * y, x**2 - y**2])
        pairs.append(replace(c, left=c.left + shift, right=c.right + shift))
    scores = np.array(list(deviations(calibrate(pairs, SIZE), cameras()).values()))
    assert np.sqrt(np.mean(scores**2)) < 2


@pytest.mark.parametrize("distortion", [0, 2, 4, 5, 8])
def test_the_lens_has_as_many_coefficients_as_asked_for(distortion: int) -> None:
    truth = cameras(distorted=distortion > 0)
    if distortion == 2:
        left, right = (replace(c, distortion=c.distortion * [1, 1, 0, 0]) for c in (truth.left, truth.right))
        truth = Cameras(left, right, truth.rotation, truth.translation)
    found = calibrate(seen(12, 0.01, by=truth), SIZE, distortion=distortion)
    assert found.error < 0.02
    assert found.cameras.left.focal == pytest.approx(truth.left.focal, rel=2e-3)
    free = [name for name in found.deviations if name.startswith("left.") and name[5] in "kp"]
    assert len(free) == distortion
    assert len(found.cameras.left.distortion) == {0: 0, 2: 4}.get(distortion, distortion)
    assert np.count_nonzero(found.cameras.left.distortion) == distortion


def test_pairs_that_do_not_fit_are_left_out_and_named() -> None:
    pairs = seen(12, 0.2)
    random = np.random.default_rng(1)
    # Corners that are off, and a pair whose images were not taken at the same time.
    pairs[4] = replace(pairs[4], right=pairs[4].right + random.normal(0, 5, pairs[4].right.shape))
    pairs[9] = replace(pairs[9], right=pairs[2].right)
    found = calibrate(pairs, SIZE)
    assert found.left_out == (4, 9)
    assert min(found.pair_errors[4], found.pair_errors[9]) > 3
    assert found.error == pytest.approx(0.2 * 2**0.5, rel=0.1)
    assert max(map(abs, deviations(found, cameras()).values())) < 4
    assert "pair 4" in summary(found)
    # Never more than a quarter: the rest of them stays, and the verdict tells.
    for k in (0, 1):
        pairs[k] = replace(pairs[k], right=pairs[k].right + random.normal(0, 30, pairs[k].right.shape))
    many = calibrate(pairs, SIZE)
    assert len(many.left_out) == 3
    assert "more pairs than a quarter" in many.verdict


def test_corners_counted_from_the_other_end_are_turned() -> None:
    """Half a turn leaves a chessboard the same, and a square one a quarter of a turn."""
    pairs = seen(10, 0.2)
    flipped = [replace(c, right=c.right[::-1]) if c.number in (0, 3, 7) else c for c in pairs]
    found = calibrate(flipped, SIZE)
    assert found.turned == (0, 3, 7)
    assert found.left_out == ()
    assert found.error == pytest.approx(calibrate(pairs, SIZE).error, rel=1e-6)
    # In every pair: the images agree among themselves on the wrong end.
    every = calibrate([replace(c, right=c.right[::-1]) for c in pairs], SIZE)
    np.testing.assert_allclose(every.cameras.rotation, found.cameras.rotation, atol=1e-6)
    square = Board.parse("chessboard 7x7 10 mm")
    pairs = seen(10, 0.2, board=square)
    quarter = np.arange(49).reshape(7, 7).T[:, ::-1].ravel()
    found = calibrate([replace(c, left=c.left[quarter]) if c.number in (2, 5) else c for c in pairs], SIZE)
    assert found.turned == (2, 5)
    assert found.error == pytest.approx(0.28, rel=0.1)


def test_boards_that_are_not_tilted_are_told() -> None:
    found = calibrate(seen(12, 0.2, tilt=0.03), SIZE)
    assert not found.usable
    assert "not usable: the boards are not tilted" in found.verdict
    assert found.deviations["left.fx"] > 20
    assert found.tilts[1] < 5
    assert "Tilt the board" in summary(found)


def test_what_makes_a_calibration_poor_is_told() -> None:
    few = calibrate(seen(4, 0.8), SIZE)
    assert few.usable
    assert "4 pairs are few" in few.verdict
    assert json.loads(json.dumps(numbers(few), allow_nan=False))["usable"]
    assert "focal lengths are known to" in few.verdict
    noisy = calibrate(seen(12, 1.0), SIZE)
    assert "the error is 1.4" in noisy.verdict
    small = calibrate(seen(12, 0.1, wide=0.01), SIZE)
    assert "corners cover" in small.verdict
    near = Cameras(cameras().left, cameras().right, turn(0, 0.02, 0), np.array([-0.01, 0, 0]))
    close = calibrate(seen(12, 0.1, by=near), SIZE)
    assert "nearly the same side" in close.verdict
    assert close.usable
    assert close.sight == pytest.approx(np.degrees(0.01 / 0.43), rel=0.15)


def test_one_camera_in_place_of_two_is_told() -> None:
    found = calibrate([replace(c, right=c.left) for c in seen(12, 0.1)], SIZE)
    assert not found.usable
    assert "nearly the same side (angle 0.0" in found.verdict


def test_angle_and_coverage_are_what_they_are_called() -> None:
    found = calibrate(seen(12, 0.0), SIZE)
    assert found.spread > found.tilts[1] > found.tilts[0]
    axes = np.array([[0, 0, 1.0], cameras().rotation[2]])
    assert found.cameras.angle == pytest.approx(np.degrees(np.arccos(axes[0] @ axes[1])), abs=1e-6)
    slopes: list[float] = []
    for w in 1e-6 * np.eye(3):
        ends = [replace(cameras(), rotation=turn(*k * w) @ cameras().rotation).angle for k in (-1, 1)]
        slopes.append(float(np.radians(ends[1] - ends[0])) / 2e-6)
    np.testing.assert_allclose(angle_by_turn(cameras().rotation), slopes, atol=1e-6)
    # The middle of the first pixel, and of the last.
    assert coverage(np.array([[0.0, 0.0], [799.0, 599.0], [1.0, 1.0]]), (800, 600)) == pytest.approx(2 / 48)


def test_cameras_may_differ_in_size() -> None:
    small = cameras((640, 480)).right
    both = Cameras(cameras().left, small, cameras().rotation, cameras().translation)
    found = calibrate(seen(12, 0.1, by=both), SIZE, (640, 480))
    assert found.cameras.right.size == (640, 480)
    assert found.cameras.right.focal == pytest.approx(small.focal, rel=5e-3)


def test_corners_outside_of_the_images_are_told() -> None:
    with pytest.raises(InputError, match=r"pair 0: its corners in the left image .* has 960 x 640 pixels"):
        calibrate(seen(5, 0.0), (960, 640))


def test_corners_that_cannot_be_used_are_all_named() -> None:
    pairs = seen(5, 0.0)
    with pytest.raises(InputError, match=r"2 pair\(s\) show the board, at least 3"):
        calibrate(pairs[:2], SIZE)
    pairs[1] = replace(pairs[1], left=pairs[1].left[:-1])
    pairs[2] = replace(pairs[2], left=pairs[2].left * np.nan)
    pairs[3] = Corners(3, BOARD.points[:10], pairs[3].left[:10], pairs[3].right[:10])
    pairs[4] = replace(pairs[4], number=0)
    with pytest.raises(InputError) as raised:
        calibrate(pairs, (0, 0), distortion=3)
    text = str(raised.value)
    for part in (
        "(69, 2)",
        "not finite",
        "lie on a line",
        "pair 0: stands twice",
        "0, 2, 4, 5, 8",
        "size",
    ):
        assert part in text


# -- boards and tables
# ------------------------------------------------------------------------------------------------------------------


def test_a_board_is_read_and_written() -> None:
    assert Board("chessboard", 10, 7, 0.01) == BOARD
    some = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0.09, 0.06, 0]])
    np.testing.assert_allclose(BOARD.points[[0, 1, 10, -1]], some, atol=1e-12)
    charuco = Board.parse("charuco 8x6 30 mm 22mm DICT_5X5_100")
    assert (charuco.square, charuco.marker) == pytest.approx((0.03, 0.022))
    assert charuco.points.shape == (35, 3)
    for board in (BOARD, charuco, replace(charuco, legacy=True)):
        assert Board.parse(str(board)) == board
    pattern = cv2.aruco.CharucoBoard((8, 6), 0.03, 0.022, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    np.testing.assert_allclose(charuco.points, pattern.getChessboardCorners(), atol=1e-6)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["expected", "chessboard 10x7 10 mm"]),
        ("circles 4x11 20 mm", ["expected", "charuco 8x6"]),
        ("chessboard 10 10 mm", ["columns x rows", "'10'"]),
        ("chessboard 10x2 10 mm", ["3 to 200", "10x2"]),
        ("chessboard 10x7 10", ["no unit"]),
        ("chessboard 10x7 10 kg", ["'kg' cannot be used here"]),
        ("chessboard 10x7 -1 mm", ["above 0"]),
        ("chessboard ax7", ["columns x rows", "1 length(s) with unit"]),
        ("charuco 8x6 30 mm DICT_5X5_100", ["2 length(s) with unit"]),
        ("charuco 8x6 30 mm 22 mm", ["dictionary: is missing"]),
        ("charuco 8x6 30 mm 40 mm DICT_5X5_10", ["DICT_5X5_10' is not known", "must be smaller"]),
        ("charuco 30x20 30 mm 22 mm DICT_5X5_100", ["has 100 markers, the board needs 300"]),
    ],
)
def test_a_board_that_is_not_clear_is_refused(text: str, parts: list[str]) -> None:
    with pytest.raises(InputError) as raised:
        Board.parse(text)
    for part in parts:
        assert part in str(raised.value)


def table(pairs: list[Corners], first: float = 0.0) -> str:
    lines = ["pair,corner,Xb_mm,Yb_mm,u1,v1,u2,v2"]
    for c in pairs:
        for i, row in enumerate(np.hstack([c.board[:, :2] * 1e3, c.left + first, c.right + first])):
            lines.append(f"{c.number},{i}," + ",".join(f"{value:.9g}" for value in row))
    return "\n".join(lines) + "\n"


def test_corners_are_read_from_a_table(tmp_path: Path) -> None:
    pairs = seen(3, 0.0)
    file = tmp_path / "corners.csv"
    file.write_text(table(pairs, first=1.0))
    found = read_corners(file, first=1.0)
    assert [c.number for c in found] == [0, 1, 2]
    np.testing.assert_allclose(found[2].left, pairs[2].left, atol=1e-5)
    np.testing.assert_allclose(found[2].right, pairs[2].right, atol=1e-5)
    np.testing.assert_allclose(found[2].board, pairs[2].board, atol=1e-12)
    # A corner that one camera did not see.
    lines = table(pairs).splitlines()
    lines[1] = ",".join([*lines[1].split(",")[:6], "", ""])
    file.write_text("\n".join(lines))
    assert [len(c) for c in read_corners(file)] == [69, 70, 70]
    lines[0] = "pair,corner,x,y,u1,v1,u2,v2"
    file.write_text("\n".join(lines))
    with pytest.raises(InputError, match="one unit is needed"):
        read_corners(file)


def test_what_is_wrong_in_a_table_is_told_by_line(tmp_path: Path) -> None:
    file = tmp_path / "corners.csv"
    rows = ["0,0,0,0,1,1,1,1", "0,0,0,0,1,1,1,1", "a,1,0,0,1,1,1,1", "1,1,,0,1,1,1,1", "1,2,0,0,1,?,1,1", "1,3,0"]
    file.write_text("\n".join(["pair,corner,x_mm,y_mm,u1,v1,u2,v2", *rows]))
    with pytest.raises(InputError) as raised:
        read_corners(file)
    text = str(raised.value)
    for part in (":3: corner 0 of pair 0 stands twice", ":4: pair", ":5: x, y", ":6: v1", "'?'", ":7: has 3 values"):
        assert part in text
    file.write_text("pair,corner,x_mm,y_mm,u1,v1\n")
    with pytest.raises(InputError, match="column u2, v2 is missing"):
        read_corners(file)
    with pytest.raises(InputError, match="no such file"):
        read_corners(tmp_path / "none.csv")


# -- from images
# ------------------------------------------------------------------------------------------------------------------

PICTURE = (720, 540)
CHARUCO = Board.parse("charuco 8x6 14 mm 10 mm DICT_4X4_50")
# Pixels of a drawn board by m.
FINE = 4000.0


def drawn(board: Board) -> tuple[NDArray[np.uint8], Array]:
    """A picture of the board with a white rim, and where on the board (m) the middle of its first pixel lies."""
    square = round(board.square * FINE)
    if board.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)
        size = (board.columns * square, board.rows * square)
        pattern.setLegacyPattern(board.legacy)
        inside, first = pattern.generateImage(size, None, 0, 1), 0
    else:
        y, x = np.mgrid[0 : (board.rows + 1) * square, 0 : (board.columns + 1) * square] // square
        inside, first = ((x + y) % 2 * 255).astype(np.uint8), square
    rim = np.pad(inside, square, constant_values=255)
    return rim, (np.array([0.5, 0.5]) - square - first) / FINE


def photographed(board: Board, pose: tuple[Array, Array], by: Camera, place: tuple[Array, Array]) -> Any:
    """What a camera without distortion sees of the board; it lies at rotation, translation from the left one."""
    picture, origin = drawn(board)
    rotation, translation = place[0] @ pose[0], place[0] @ pose[1] + place[1]
    from_pixels = np.array([[1 / FINE, 0, origin[0]], [0, 1 / FINE, origin[1]], [0, 0, 1]])
    homography = by.matrix @ np.column_stack([rotation[:, :2], translation]) @ from_pixels
    # Twice as fine and then averaged, as the cells of a sensor do; the middle of the first pixel stays at (0, 0).
    finer = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1.0]]) @ homography
    large = cv2.warpPerspective(
        cv2.GaussianBlur(picture, (0, 0), 2), finer, (2 * by.size[0], 2 * by.size[1]), borderValue=120
    )
    return cv2.resize(large, by.size, interpolation=cv2.INTER_AREA)


def poses(count: int, board: Board) -> list[tuple[Array, Array]]:
    random = np.random.default_rng(2)
    middle = (board.points.max(axis=0) + board.points.min(axis=0)) / 2
    found = []
    for k in range(count):
        rotation = turn(0.45 * np.cos(2.4 * k), 0.45 * np.sin(2.4 * k), 0.1)
        centre = np.array([*random.uniform(-0.03, 0.03, 2), random.uniform(0.36, 0.44)])
        found.append((rotation, centre - rotation @ middle))
    return found


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], tuple[Path, Path]]:
    """Makes folders with pictures of a board by two cameras."""

    def make(text: str, count: int) -> tuple[Path, Path]:
        board, by = Board.parse(text), cameras(PICTURE, distorted=False)
        folder = tmp_path_factory.mktemp(board.kind)
        places = {"left": (np.eye(3), np.zeros(3)), "right": (by.rotation, by.translation)}
        for side, place in places.items():
            (folder / side).mkdir()
            for number, pose in enumerate(poses(count, board)):
                picture = photographed(board, pose, getattr(by, side), place)
                assert cv2.imwrite(str(folder / side / f"{side}_{number:03d}.png"), picture)
        return folder / "left", folder / "right"

    return make


def recovered(run: Path, error: float) -> dict[str, Any]:
    """The result of a run whose cameras are those of the pictures."""
    found, truth = Cameras.read(run / "cameras.json"), cameras(PICTURE, distorted=False)
    content: dict[str, Any] = json.loads((run / "calibration.json").read_text())
    assert content["error"] == pytest.approx(found.error, rel=1e-9)
    assert found.error is not None
    assert found.error < error
    for side in ("left", "right"):
        assert getattr(found, side).focal == pytest.approx(getattr(truth, side).focal, rel=0.01)
        # Half a pixel lost between board, image and file would be seen here.
        centre = getattr(found, side).matrix[:2, 2] - getattr(truth, side).matrix[:2, 2]
        doubt = np.array([content[side]["deviations"][name] for name in ("cx", "cy")])
        assert np.all(np.abs(centre) < 4 * doubt + 0.5)
    assert found.baseline == pytest.approx(truth.baseline, rel=0.005)
    assert json.loads((run / "run.json").read_text())["state"] == "finished"
    return content


def test_from_pictures_of_a_chessboard_to_a_run_folder(
    pictures: Callable[[str, int], tuple[Path, Path]], tmp_path: Path
) -> None:
    left, right = pictures("chessboard 10x7 10 mm", 8)
    # Cut short, black, and only in one camera.
    cut = left / "left_005.png"
    cut.write_bytes(cut.read_bytes()[:2000])
    cv2.imwrite(str(right / "right_006.png"), np.zeros(PICTURE[::-1], np.uint8))
    (right / "right_007.png").unlink()
    run = run_calibration(left, right, "chessboard 10x7 10 mm", tmp_path / "run", distortion=0)
    content = recovered(run, 0.04)
    assert [pair["number"] for pair in content["pairs"]] == [0, 1, 2, 3, 4]
    reasons = {entry["number"]: entry["reason"] for entry in content["not_found"]}
    assert list(reasons) == [5, 6, 7]
    assert "left: left_005.png is cut short" in reasons[5]
    assert "right: no chessboard with 10x7" in reasons[6]
    assert reasons[7] == f"is only in {left}"
    text = (run / "summary.txt").read_text()
    assert text.startswith("Calibration of two cameras: usable with care: 5 pairs are few")
    assert "pair 5: left" in text
    assert draw_pictures(run) == [run / "calibration.png"]
    assert cv2.imread(str(run / "calibration.png")).shape[1] == 1800
    with pytest.raises(InputError, match="holds a finished run"):
        run_calibration(left, right, "chessboard 10x7 10 mm", run)


def test_from_pictures_of_a_charuco_board(pictures: Callable[[str, int], tuple[Path, Path]], tmp_path: Path) -> None:
    left, right = pictures(str(CHARUCO), 5)
    # A board of which one camera sees a part.
    file = right / "right_002.png"
    part = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    part[230:] = 90
    cv2.imwrite(str(file), part)
    run = run_calibration(left, right, str(CHARUCO), tmp_path / "run", distortion=0)
    content = recovered(run, 0.1)
    counts = [len(pair["board"]) for pair in content["pairs"]]
    assert counts[0] == counts[1] == 35
    assert 6 <= counts[2] < 35


def test_the_old_layout_of_charuco_boards_is_read_and_its_lack_told() -> None:
    old = replace(CHARUCO, legacy=True)
    picture, origin = drawn(old)
    found = corners_in(picture, old)
    assert isinstance(found, dict)
    for number, pixel in found.items():
        np.testing.assert_allclose(pixel / FINE + origin, old.points[number, :2], atol=0.5 / FINE)
    assert len(found) == 35
    answer = corners_in(picture, CHARUCO)
    assert isinstance(answer, str)
    assert "'legacy'" in answer
    assert "no marker of DICT_4X4_50" in str(corners_in(np.full((200, 300), 90, np.uint8), CHARUCO))


def test_nothing_is_written_when_pictures_cannot_be_used(
    pictures: Callable[[str, int], tuple[Path, Path]], tmp_path: Path
) -> None:
    left, right = pictures("chessboard 10x7 10 mm", 2)
    run = tmp_path / "run"
    with pytest.raises(InputError, match=r"2 pair\(s\) show the chessboard 10x7 10 mm"):
        run_calibration(left, right, "chessboard 10x7 10 mm", run)
    with pytest.raises(InputError, match="columns x rows"):
        run_calibration(left, right, "chessboard 10 10 mm", run)
    with pytest.raises(InputError, match="0, 2, 4, 5, 8"):
        run_calibration(left, right, "chessboard 10x7 10 mm", run, distortion=3)
    with pytest.raises(InputError, match=r"(?s)left: .*none: no such.*right: .*nought: no such"):
        run_calibration(tmp_path / "none", tmp_path / "nought", "chessboard 10x7 10 mm", run)
    for number, file in enumerate(sorted(right.iterdir())):
        file.rename(right / f"{number + 50}.png")
    with pytest.raises(InputError, match="no image has the same number in both"):
        run_calibration(left, right, "chessboard 10x7 10 mm", run)
    assert not run.exists()


def test_a_failed_calibration_leaves_the_last_one(
    pictures: Callable[[str, int], tuple[Path, Path]], tmp_path: Path
) -> None:
    text, run = "chessboard 10x7 10 mm", tmp_path / "run"
    left, right = pictures(text, 4)
    run_calibration(left, right, text, run, distortion=0)
    before = (run / "calibration.json").read_text()
    hidden = [(file, tmp_path / file.name) for file in sorted(right.iterdir())[:2]]
    for file, elsewhere in hidden:
        file.rename(elsewhere)
    with pytest.raises(InputError, match="at least 3"):
        run_calibration(left, right, text, run, distortion=0, overwrite=True)
    assert (run / "calibration.json").read_text() == before
    hidden[0][1].rename(hidden[0][0])
    run_calibration(left, right, text, run, distortion=0, overwrite=True)
    assert [pair["number"] for pair in json.loads((run / "calibration.json").read_text())["pairs"]] == [0, 2, 3]
