"""From images to a measurement, with beads drawn as discs where closed forms say they are."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn import DIAMETER, LAYOUT, REST, SHIFT, TO_CAMERA, cameras, draw, in_camera, pulled

from bcid import Measurement
from bcid.app.cli import main
from bcid.base.errors import InputError, MachineError
from bcid.base.run_folder import RunFolder
from bcid.measurement import Units
from bcid.measurement.folder import read_grasps
from bcid.vision.camera import Camera, Cameras
from bcid.vision.layout import find, neighbours
from bcid.vision.recording import Recording
from bcid.vision.register import register, rigid
from bcid.vision.track import Tracker, working_distance
from bcid.vision.track_run import run_tracking
from bcid.vision.tracking import track
from bcid.vision.triangulate import Points, epipolar_distance, triangulate

STEPS, SIZE = 10, 7.5
RNG = 3
AMOUNTS = 0.02 * np.sin(np.linspace(0, np.pi / 2, STEPS))
# Of a bead near a corner of the layout, in the left of the first images.
SEEN = '[seen]\n"1" = [{:.0f}, {:.0f}]\n'


def places(step: int) -> np.ndarray:
    return in_camera(pulled(REST, float(AMOUNTS[step])))


def pair(step: int, rig: Cameras, rng: np.random.Generator, hidden: np.ndarray | None = None) -> list[np.ndarray]:
    hidden = np.zeros((2, 16), bool) if hidden is None else hidden
    both = zip(rig.project(places(step)), hidden, strict=True)
    return [draw(pixels, SIZE, rng, hidden=gone) for pixels, gone in both]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with images, cameras, motions and a recording file; bead 6 is hidden from the right camera in steps 3 to 5."""
    folder = tmp_path_factory.mktemp("recorded")
    rng, rig = np.random.default_rng(RNG), cameras()
    rig.write(folder / "cameras.json")
    for side in ("left", "right"):
        (folder / side).mkdir()
    for step in range(STEPS):
        hidden = np.zeros((2, 16), bool)
        hidden[1, 5] = 3 <= step <= 5
        for side, image in zip(("left", "right"), pair(step, rig, rng, hidden), strict=True):
            cv2.imwrite(str(folder / side / f"{side}_{step + 100}.png"), image)
    lines = ["action,step,time,grasp,x,y,z,qw,qx,qy,qz"]
    lines += [f"1,{step},{step},II,{AMOUNTS[step] * 1e3:.6f},0,0,1,0,0,0" for step in range(STEPS)]
    (folder / "grasps.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = (
        'format = "bcid-recording/1"\ncameras = "cameras.json"\nleft = "left"\nright = "right"\ngrasps = "grasps.csv"\n'
    )
    text += '\n[beads]\ndiameter = "1 mm"\n' + SEEN.format(*rig.project(places(0))[0][0])
    (folder / "recording.toml").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture
def changed(recorded: Path, tmp_path: Path) -> Callable[..., Path]:
    """Makes a copy of the recording with other text in its file; returns the file."""

    def change(old: str = "", new: str = "") -> Path:
        copy = tmp_path / "recording"
        shutil.copytree(recorded, copy)
        file = copy / "recording.toml"
        text = file.read_text(encoding="utf-8")
        assert old in text
        file.write_text(text.replace(old, new), encoding="utf-8")
        return file

    return change


# -- triangulation
# ------------------------------------------------------------------------------------------------------------------


def test_points_come_back_from_their_pixels() -> None:
    rig, points = cameras((-0.2, 0.1, 1e-3, -2e-3)), places(STEPS - 1)
    assert np.abs(triangulate(rig, *rig.project(points)).positions - points).max() < 1e-12
    assert epipolar_distance(rig, *rig.project(points)).diagonal().max() < 1e-9


def test_the_covariance_of_a_point_is_that_of_its_errors() -> None:
    """Over 4000 draws of noise that is larger in one camera, and along one axis."""
    rig, rng = cameras(), np.random.default_rng(0)
    point = np.tile(places(5)[3], (4000, 1))
    left, right = np.diag([0.04, 0.01]), np.diag([0.01, 0.02])
    pixels = [
        p + rng.normal(size=p.shape) * np.sqrt(np.diag(c))
        for p, c in zip(rig.project(point), (left, right), strict=True)
    ]
    found = triangulate(rig, *pixels, np.tile(left, (4000, 1, 1)), np.tile(right, (4000, 1, 1)))
    error = found.positions - point
    chi2 = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance), error)
    assert chi2.mean() == pytest.approx(3, rel=0.05)
    assert found.misfit.mean() == pytest.approx(1, rel=0.07)
    assert np.abs(error.mean(axis=0)).max() < 1e-5


def test_a_point_that_one_camera_does_not_show_has_no_place() -> None:
    rig = cameras()
    left, right = rig.project(places(0))
    right[4] = np.nan
    found = triangulate(rig, left, right)
    assert np.isnan(found.positions[4]).all()
    assert np.isfinite(np.delete(found.positions, 4, axis=0)).all()


def test_the_working_distance_is_where_the_axes_meet() -> None:
    assert working_distance(cameras()) == pytest.approx(0.3, rel=1e-12)
    with pytest.raises(InputError, match='distance = "300 mm"'):
        working_distance(replace(cameras(), rotation=np.eye(3), translation=np.array([-0.1, 0, 0])))


# -- calibration files
# ------------------------------------------------------------------------------------------------------------------


def test_cameras_are_read_back(tmp_path: Path) -> None:
    rig = replace(cameras(), error=0.31)
    rig.write(tmp_path / "cameras.json")
    again = Cameras.read(tmp_path / "cameras.json")
    assert np.array_equal(again.rotation, rig.rotation)
    assert np.array_equal(again.translation, rig.translation)
    assert np.array_equal(again.right.matrix, rig.right.matrix)
    assert (again.left.size, again.error) == ((1280, 1024), 0.31)


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
@pytest.mark.parametrize(
    "names", [("K1", "D1", "K2", "D2"), ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2")]
)
def test_cameras_of_opencv_are_read(tmp_path: Path, suffix: str, names: tuple[str, str, str, str]) -> None:
    rig, file = cameras(), tmp_path / f"stereo.{suffix}"
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    values = (rig.left.matrix, rig.left.distortion, rig.right.matrix, rig.right.distortion)
    for name, value in (*zip(names, values, strict=True), ("R", rig.rotation), ("T", rig.translation * 1e3)):
        storage.write(name, value)
    storage.release()
    found = Cameras.read(file, "mm")
    assert np.allclose(found.translation, rig.translation, rtol=1e-12)
    assert np.allclose(found.right.distortion, rig.right.distortion)
    with pytest.raises(InputError, match='length_unit: of the translation is not stated; give it, as "mm"'):
        Cameras.read(file)


def test_plain_matrices_are_read(tmp_path: Path) -> None:
    rig, file = cameras(), tmp_path / "cameras.toml"
    matrices = {"K_left": rig.left.matrix, "K_right": rig.right.matrix, "D_left": rig.left.distortion}
    matrices |= {"D_right": rig.right.distortion, "R": rig.rotation, "T": rig.translation * 1e3}
    lines = [f"{name} = {value.tolist()}" for name, value in matrices.items()]
    file.write_text('length_unit = "mm"\nimage_size = [1280, 1024]\n' + "\n".join(lines), encoding="utf-8")
    found = Cameras.read(file)
    assert np.allclose(found.translation, rig.translation)
    assert found.right.size == (1280, 1024)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}, "is not a rotation matrix"),
        ({"translation": [0, 0, 0]}, "the translation between the cameras is zero"),
        (
            {"left": {"matrix": [[1, 0], [0, 1]], "distortion": [], "size": [4, 4]}},
            "left.matrix: expected 3 x 3 numbers",
        ),
        (
            {"right": {"matrix": np.eye(3).tolist(), "distortion": [1, 2, 3], "size": [4, 4]}},
            "has 3 coefficients of distortion",
        ),
        ({"length_unit": "V"}, "unit 'V' is not known"),
        ({"left": 3}, "left: the camera is missing"),
    ],
)
def test_bad_cameras_are_refused(tmp_path: Path, change: dict[str, object], words: str) -> None:
    file = tmp_path / "cameras.json"
    cameras().write(file)
    file.write_text(json.dumps(json.loads(file.read_text()) | change), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        Cameras.read(file)


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", "\x00\x01", "%YAML:1.0\n---\nK1: !!opencv-matrix\n  rows: 3"])
@pytest.mark.parametrize("suffix", ["json", "yml", "toml"])
def test_what_is_no_calibration_is_refused(tmp_path: Path, text: str, suffix: str) -> None:
    file = tmp_path / f"cameras.{suffix}"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"cameras\."):
        Cameras.read(file)


def test_a_lens_that_cannot_be_undone_gives_nothing() -> None:
    camera = Camera(cameras().left.matrix, np.array([-0.9, 0.0, 0.0, 0.0]), (1280, 1024))
    rays = camera.undistort(np.array([[640.0, 512.0], [5000.0, 4000.0]]))
    assert np.isfinite(rays[0]).all()
    assert np.isnan(rays[1]).all()


# -- registration
# ------------------------------------------------------------------------------------------------------------------


def seen_at_rest(noise: float, rng: np.random.Generator, layout_noise: float = 0.0) -> Points:
    positions = in_camera(REST + rng.normal(0, layout_noise, REST.shape)) + rng.normal(0, noise, REST.shape)
    return Points(positions, np.tile(noise**2 * np.eye(3), (16, 1, 1)), np.zeros(16))


def test_the_motion_of_the_frame_is_found_within_its_covariance() -> None:
    """Normalised errors over 200 draws; the layout's own errors are found from what is left."""
    rng = np.random.default_rng(0)
    for layout_noise, scale in ((0.0, False), (0.0, True), (5e-4, True)):
        chi2 = []
        for _ in range(200):
            found = register(seen_at_rest(2e-5, rng, layout_noise), REST, scale=scale)
            away = found.to_body(in_camera(REST)) - REST
            shift = away.mean(axis=0)
            size = np.sqrt(np.diag(found.error.covariance)[3:6])
            chi2.append(np.mean((shift / size) ** 2))
        assert np.mean(chi2) == pytest.approx(1.0, abs=0.25)


def test_what_is_not_known_of_the_frame_is_an_error_in_common() -> None:
    """The modes of the frame's error have the covariance of what 500 registrations do to two points far apart."""
    rng = np.random.default_rng(1)
    far = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.1]])
    shifts = np.array(
        [(register(seen_at_rest(1e-4, rng), REST).to_body(in_camera(far)) - far).ravel() for _ in range(500)]
    )
    modes = register(seen_at_rest(1e-4, rng), REST).error.modes(far).reshape(6, -1)
    stated, found = modes @ modes.T, np.cov(shifts.T)
    assert np.abs(found - stated).max() < 0.25 * np.abs(stated).max()
    assert found[0, 3] * stated[0, 3] > 0


def test_a_wrong_scale_is_seen() -> None:
    points = seen_at_rest(2e-5, np.random.default_rng(2))
    found = register(replace(points, positions=points.positions / 1.01), REST)
    scale, error = found.free_scale
    assert scale == pytest.approx(1.01, abs=3 * error)
    assert error < 1e-3


def test_a_layout_is_found_among_false_points() -> None:
    rng = np.random.default_rng(4)
    layout = rng.uniform(0, 0.1, (12, 3))
    points = np.vstack([in_camera(layout)[:9], in_camera(rng.uniform(-0.02, 0.12, (30, 3)))])
    order = rng.permutation(len(points))
    ways = find(points[order], layout, 1e-3)
    assert len(ways) == 1
    assert [int(order[p]) if p >= 0 else -1 for p in ways[0].points] == [*range(9), -1, -1, -1]


def test_a_symmetric_layout_lies_in_several_ways() -> None:
    """A rectangle of beads can be turned by half a turn about three axes."""
    assert len(find(in_camera(REST), REST, 1e-3)) == 4
    assert len(find(in_camera(REST), REST, 1e-3, {0: np.array([0])})) == 1
    # Of two beads that are named, one may not have been found.
    alone = find(np.delete(in_camera(REST), 15, axis=0), REST, 1e-3, {0: np.array([0]), 15: np.array([], dtype=int)})
    assert [tuple(way.points) for way in alone] == [(*range(15), -1)]


def test_a_part_of_a_lattice_lies_in_several_ways() -> None:
    """Few beads of a regular layout are as well those of the next row, whatever single bead is known."""
    some = [0, 1, 2, 4, 5, 6, 8]
    points = in_camera(REST)[some]
    assert len(find(points, REST, 1e-3, {5: np.array([4])})) > 1
    alone = find(points, REST, 1e-3, {5: np.array([4]), 0: np.array([0]), 2: np.array([2])})
    assert [list(way.points[some]) for way in alone] == [list(range(7))]


def test_rigid_motion_and_scale() -> None:
    rotation, translation, scale = rigid(REST, 2 * in_camera(REST), True)
    assert np.allclose(rotation, TO_CAMERA)
    assert np.allclose(translation, 2 * SHIFT)
    assert scale == pytest.approx(2)


# -- following
# ------------------------------------------------------------------------------------------------------------------


def test_neighbours_say_what_a_smooth_motion_is() -> None:
    moved = pulled(REST, 0.02) - REST
    assert np.abs(neighbours(REST, moved) - moved).max() < 2e-3
    row = np.column_stack([np.linspace(0, 0.1, 8), np.zeros(8), np.zeros(8)])
    assert np.abs(neighbours(row, pulled(row, 0.02) - row) - (pulled(row, 0.02) - row)).max() < 2e-3


def test_a_recording_becomes_a_measurement(recorded: Path) -> None:
    """Positions to 0.05 mm, honest standard deviations, the hidden bead a gap and found again."""
    recording = Recording.read(recorded / "recording.toml")
    found = track(recording, LAYOUT)
    truth = np.array([pulled(REST, amount) for amount in AMOUNTS])
    gone = ~found.seen
    assert gone.sum() == 3
    assert gone[3:6, 5].all()
    error = found.positions - truth
    assert np.sqrt(np.nanmean(error**2)) < 2e-5
    chi2 = np.einsum("fni,fnij,fnj->fn", error, np.linalg.inv(found.covariance), error)
    assert np.nanmean(chi2) / 3 < 3
    assert found.warnings == []
    made = found.measurement(recording)
    assert made.action_names == ["1"]
    assert np.allclose(made.actions[0].translation[:, 0], AMOUNTS, atol=1e-9)
    assert np.array_equal(np.isnan(made.data["sigma"].values), np.isnan(made.positions))


@pytest.mark.parametrize("fault", ["frames are lost", "no right to write"])
def test_track_whose_film_cannot_be_written_ends_with_a_fault_of_the_machine(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    """OpenCV does not say that a disk is full: the film that it has written has fewer frames."""

    class Writer:
        def __init__(self, path: str, *_: object) -> None:
            self.path = Path(path)

        def isOpened(self) -> bool:
            return fault == "frames are lost"

        def write(self, _: object) -> None:
            self.path.write_bytes(b"the begin of a film")

        def release(self) -> None:
            """Nothing is left to be done."""

    monkeypatch.setattr(cv2, "VideoWriter", Writer)
    with pytest.raises(MachineError, match=r"film\.mp4: cannot be written"):
        run_tracking(recorded / "recording.toml", dict(LAYOUT), tmp_path / "run")
    assert not list((tmp_path / "run").glob("*film*"))
    assert not list((tmp_path / "run").glob(".film*"))
    assert RunFolder.open(tmp_path / "run").record["state"] == "failed"


def test_beads_are_found_where_a_model_has_them(recorded: Path, tmp_path: Path) -> None:
    """The body jumps by more than beads are looked for; a model knows."""
    rng, rig = np.random.default_rng(0), cameras()
    tracker = Tracker(rig, LAYOUT, DIAMETER)
    hint = {"1": tuple(rig.project(places(0))[0][0])}
    tracker.begin(*pair(0, rig, rng), hints=hint)
    jump = np.array([0.013, 0.0, 0.0])
    images = [draw(pixels, SIZE, rng) for pixels in rig.project(places(0) + jump)]
    assert tracker.follow(*images, moved=np.tile(jump, (16, 1))).seen.sum() == 16
    lost = Tracker(rig, LAYOUT, DIAMETER)
    lost.begin(*pair(0, rig, rng), hints=hint)
    wrong = lost.follow(*images)
    assert np.sum(np.linalg.norm(wrong.points.positions - places(0) - jump, axis=1) < 1e-3) < 8


def test_two_beads_are_never_swapped(recorded: Path) -> None:
    """Where two beads come near to each other and one is hidden, its name stays with its place."""
    rig, rng = cameras(), np.random.default_rng(5)
    tracker = Tracker(rig, LAYOUT, DIAMETER)
    tracker.begin(*pair(0, rig, rng), hints={"1": tuple(rig.project(places(0))[0][0])})
    decoy = places(0)[5] + np.array([4e-3, 2e-3, 0])
    for step in range(1, STEPS):
        hidden = np.zeros(17, bool)
        hidden[5] = step > 2
        truth = places(step)
        images = [draw(pixels, SIZE, rng, hidden=hidden) for pixels in rig.project(np.vstack([truth, decoy]))]
        frame = tracker.follow(*images)
        error = np.linalg.norm(frame.points.positions - truth, axis=1)
        assert np.nanmax(error) < 2e-4
        assert frame.seen[5] == (step <= 2)


# -- warnings and refusals
# ------------------------------------------------------------------------------------------------------------------


def test_a_symmetric_layout_needs_a_hint(changed: Callable[..., Path]) -> None:
    file = changed('[seen]\n"1"', "#")
    with pytest.raises(InputError, match=r'in 4 ways: bead \d+ is at .* say which with \[seen\] "\d+" = \[u, v\]'):
        track(Recording.read(file), LAYOUT)


def test_a_hint_at_no_spot_is_named(changed: Callable[..., Path]) -> None:
    """Unless another bead that is named is there."""
    file = changed()
    text = file.read_text(encoding="utf-8")
    nowhere = '"2" = [20, 30]\n'
    file.write_text(text + nowhere, encoding="utf-8")
    assert track(Recording.read(file), LAYOUT).warnings == []
    file.write_text(text[: text.index("[seen]")] + "[seen]\n" + nowhere, encoding="utf-8")
    with pytest.raises(
        InputError, match=r"no spot of the left image is at 20, 30 \(bead 2; the nearest is \d+ px away\)"
    ):
        track(Recording.read(file), LAYOUT)


def test_a_camera_that_was_moved_is_named(changed: Callable[..., Path]) -> None:
    """By half a degree about its horizontal axis."""
    file = changed()
    rig = cameras()
    turn = cv2.Rodrigues(np.radians([0.5, 0.0, 0.0]))[0]
    replace(rig, rotation=turn @ rig.rotation, translation=turn @ rig.translation).write(file.parent / "cameras.json")
    with pytest.raises(InputError, match=r"the calibration does not fit the images. Spots are .* px \(median\)"):
        track(Recording.read(file), LAYOUT)


@pytest.mark.parametrize("axis", range(3))
def test_a_camera_that_is_turned_by_a_degree_is_noticed(changed: Callable[..., Path], axis: int) -> None:
    """About its own axes: by the epipolar lines, or, where the turn keeps these, by the scale."""
    file = changed()
    rig = cameras()
    turn = cv2.Rodrigues(np.radians(np.eye(3)[axis]))[0]
    replace(rig, rotation=turn @ rig.rotation).write(file.parent / "cameras.json")
    try:
        said = track(Recording.read(file), LAYOUT).warnings[0]
    except InputError as error:
        said = str(error)
    assert "the calibration does not fit the images" in said or "than in the layout" in said


def test_a_board_of_the_wrong_size_is_named(changed: Callable[..., Path]) -> None:
    file = changed()
    rig = cameras()
    replace(rig, translation=rig.translation * 1.01).write(file.parent / "cameras.json")
    warnings = track(Recording.read(file), LAYOUT).warnings
    assert len(warnings) == 1
    assert "1 % larger than in the layout (scale 0.99" in warnings[0]


def test_missing_and_broken_images_are_gaps(changed: Callable[..., Path]) -> None:
    file = changed()
    left, right = file.parent / "left", file.parent / "right"
    (left / "left_102.png").unlink()
    data = (right / "right_103.png").read_bytes()
    (right / "right_103.png").write_bytes(data[: len(data) // 2])
    cv2.imwrite(str(left / "left_104.png"), np.zeros((1024, 1280), np.uint8))
    cv2.imwrite(str(right / "right_106.png"), np.zeros((512, 640), np.uint8))
    found = track(Recording.read(file), LAYOUT)
    assert found.seen.any(axis=1).tolist() == [True, True, False, False, False, True, False, True, True, True]
    truth = np.array([pulled(REST, amount) for amount in AMOUNTS])
    assert np.nanmax(np.abs(found.positions - truth)) < 5e-4
    told = "\n".join(found.troubles)
    for words in ("left image 102", "right image 103", "right image 106", "640 x 512"):
        assert words in told
    assert "No bead was found in 4 of 10 pairs of images: 102, 103, 104, 106." in found.warnings[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"1 mm"', '"9 mm"', "of 16 beads were found at rest"),
        ('"1 mm"', '"1 kg"', "beads.diameter"),
        ('"1 mm"', '"-1 mm"', "beads.diameter: must be positive"),
        ("[beads]", "[bead]", "bead: unknown key; did you mean 'beads'"),
        ('left = "left"', 'left = "nowhere"', "nowhere: no such folder"),
        ('"grasps.csv"', '"motion.csv"', "motion.csv: no such file with the poses"),
        ('"cameras.json"', '"c.json"', "c.json: no such calibration file"),
        ('[seen]\n"1"', '[seen]\n"x"', "bead 'x' is not one of the layout"),
        (
            "[beads]",
            "[images]\nfirst = 101\n[beads]",
            r"the motions have 10 steps, which are images 101 to 110 .* end at 109",
        ),
        ("[beads]", "[images]\nevery = 0\n[beads]", "images.every: expected a whole number from 1"),
        ("bcid-recording/1", "bcid-scene/1", 'expected "bcid-recording/1"'),
        ('"1 mm"', '"1 mm"\ncolour = "red"', "expected dark or bright, found 'red'"),
        ('"1 mm"', '"1 mm"\ncolour = "bright"', "are their diameter .* and colour right"),
    ],
)
def test_bad_recordings_are_refused(changed: Callable[..., Path], old: str, new: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        track(Recording.read(changed(old, new)), LAYOUT)


def test_images_of_another_size_are_refused(changed: Callable[..., Path]) -> None:
    file = changed()
    rig = cameras()
    replace(rig, left=replace(rig.left, size=(1920, 1080))).write(file.parent / "cameras.json")
    with pytest.raises(
        InputError, match="the left images have 1280 x 1024 pixels, the camera was calibrated with 1920 x 1080"
    ):
        track(Recording.read(file), LAYOUT)


def test_too_few_beads_that_are_seen_are_named() -> None:
    """Five of sixteen are not enough, six are."""
    rig, rng = cameras(), np.random.default_rng(0)
    hint = {"1": tuple(rig.project(places(0))[0][0])}
    hidden = np.ones((2, 16), bool)
    hidden[:, [0, 3, 5, 12, 14]] = False
    with pytest.raises(InputError, match=r"5 of 16 beads were found at rest .*, 6 are needed: begin with images"):
        Tracker(rig, LAYOUT, DIAMETER).begin(*pair(0, rig, rng, hidden), hints=hint)
    hidden[:, 10] = False
    assert Tracker(rig, LAYOUT, DIAMETER).begin(*pair(0, rig, rng, hidden), hints=hint).seen.sum() == 6
    with pytest.raises(InputError, match=r"both cameras see no bead that is named in \[seen\]"):
        Tracker(rig, LAYOUT, DIAMETER).begin(*pair(0, rig, rng, hidden), hints={"2": hint["1"]})


def test_too_few_beads_are_refused() -> None:
    with pytest.raises(InputError, match="3 beads: at least 4 are needed"):
        Tracker(cameras(), {name: LAYOUT[name] for name in ("1", "2", "3")}, DIAMETER)


# -- the command
# ------------------------------------------------------------------------------------------------------------------


def test_beads_in_a_row_are_refused() -> None:
    row = {str(i): (0.01 * i, 0.01, 0.05) for i in range(8)}
    with pytest.raises(InputError, match="stand in a row"):
        Tracker(cameras(), row, DIAMETER)
    # Nor is a layout laid onto points of which those that fit stand in one.
    assert find(in_camera(REST)[:4], REST, 1e-3) == []


def test_the_registration_counts_an_image_once(recorded: Path) -> None:
    """Its error is that of one pair of images at rest, not of the same pair twice."""
    found = track(Recording.read(recorded / "recording.toml"), LAYOUT)
    again = register(found.frames[0].points, REST)
    assert np.allclose(found.registration.error.covariance, again.error.covariance, rtol=1e-6, atol=0)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (
            "1,0,0,II,0,0,0,1,0,0,0\n2,0,0,II,0,0,0,1,0,0,0\n1,1,1,II,1,0,0,1,0,0,0\n",
            "the rows of action 1 do not stand together",
        ),
        ("1,1,0,II,0,0,0,1,0,0,0\n", "action 1 starts at step 1"),
        ("1,0,5,II,0,0,0,1,0,0,0\n1,1,4,II,0,0,0,1,0,0,0\n", "time: goes back at step 1"),
        ("1,0,0,II,3,0,0,1,0,0,0\n", "step 0 of action 1 must be the rest pose"),
        ("", "holds no pose"),
    ],
)
def test_bad_motions_are_refused(tmp_path: Path, rows: str, words: str) -> None:
    file = tmp_path / "robot.csv"
    file.write_text("action,step,time,grasp,x,y,z,qw,qx,qy,qz\n" + rows, encoding="utf-8")
    with pytest.raises(InputError, match=f"robot.csv.*{words}"):
        read_grasps(file, Units())


def test_track_writes_a_run_folder(
    recorded: Path, project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, run = project / "examples/scenes/slab.toml", tmp_path / "run"
    assert main(["track", str(scene), str(recorded / "recording.toml"), "-o", str(run)]) == 0
    printed = capsys.readouterr().out
    assert "Tracked 16 beads through 10 pairs of images: 98.1% of the positions (157 of 160)" in printed
    assert "Nothing is suspicious." in printed
    assert RunFolder.open(run).record["state"] == "finished"
    for name in ("film.mp4", "rest.png", "tracking.png", "tracking.nc", "tracking.json", "summary.txt"):
        assert (run / name).stat().st_size > 0
    film = cv2.VideoCapture(str(run / "film.mp4"))
    assert int(film.get(cv2.CAP_PROP_FRAME_COUNT)) == STEPS
    made = Measurement.read(run / "measurement")
    assert made.frame_error is not None
    assert made.frame_error.rms(made.positions) < 1e-4
    truth = np.array([pulled(REST, amount) for amount in AMOUNTS])
    assert np.sqrt(np.nanmean((made.positions - truth) ** 2)) < 2e-5
    # A finished run is not overwritten.
    assert main(["track", str(scene), str(recorded / "recording.toml"), "-o", str(run)]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_nothing_is_written_before_the_layout_is_found(
    changed: Callable[..., Path], project: Path, tmp_path: Path
) -> None:
    file = changed('"1 mm"', '"9 mm"')
    scene = project / "examples/scenes/slab.toml"
    assert main(["track", str(scene), str(file), "-o", str(tmp_path / "run")]) == 2
    assert not (tmp_path / "run").exists()
