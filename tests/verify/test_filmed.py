"""Pictures of a board tell the cameras that took them, and a body that is filmed is measured as it moves."""

from pathlib import Path

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.base.progress import Silent
from bcid.forms.model import check_physics
from bcid.measurement import Measurement
from bcid.scene import Scene
from bcid.vision.board import Board
from bcid.vision.calibrate_run import run_calibration
from bcid.vision.camera import SIDES, Cameras
from bcid.vision.corners import find_corners
from bcid.vision.images import Images
from validation.paper.condition import Condition
from validation.paper.precompute import Store
from validation.rendering.board_images import photograph_board
from validation.rendering.rig import stereo_rig

PROJECT = Path(__file__).resolve().parents[2]
BOARD = "chessboard 9x6 10 mm"


def test_pictures_of_a_board_tell_the_cameras(tmp_path: Path) -> None:
    """Corners lie where the cameras project them, and the calibration of the pictures is that of the cameras."""
    truth, _ = stereo_rig(size=(640, 512))
    board = Board.parse(BOARD)
    poses = photograph_board(truth, board, tmp_path / "board", 10, 4)
    pairs, missing = find_corners(*(Images.open(tmp_path / "board" / side) for side in SIDES), board, Silent())
    assert not missing
    # Half a pixel lost between board and image would be seen here.
    rotation, translation = poses[pairs[0].number]
    wanted = truth.left.project(board.points @ rotation.T + translation)
    # Corners may be counted from either end of the board.
    off = min((pairs[0].left - way for way in (wanted, wanted[::-1])), key=lambda way: np.abs(way).max())
    assert np.abs(off.mean(axis=0)).max() < 0.05
    assert off.std() < 0.1
    run = run_calibration(tmp_path / "board/left", tmp_path / "board/right", BOARD, tmp_path / "run")
    found = Cameras.read(run / "cameras.json")
    assert found.error is not None
    assert found.error < 0.06
    assert found.baseline == pytest.approx(truth.baseline, rel=2e-3)
    for side in SIDES:
        one, true = getattr(found, side), getattr(truth, side)
        assert one.focal == pytest.approx(true.focal, rel=4e-3)
        assert np.abs(one.matrix[:2, 2] - true.matrix[:2, 2]).max() < 3.0


def test_only_a_chessboard_is_photographed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="only a chessboard"):
        photograph_board(stereo_rig()[0], Board.parse("charuco 8x6 14 mm 10 mm DICT_4X4_50"), tmp_path / "board", 3)
    assert not (tmp_path / "board").exists()


@pytest.mark.slow
def test_a_filmed_body_is_measured_as_it_moves(tmp_path: Path) -> None:
    """Board, cameras, beads, tracking and registration; a second look at the same trial reads what was filmed."""
    scene = PROJECT / "examples/scenes/slab_paper.toml"
    store = Store(scene, tmp_path, 5)
    condition = Condition(
        anchors=(("1", "2"),),
        seen="images",
        motion="pull",
        true_degree=2,
        true_size=14e-3,
        placement=2e-4,
        robot_turn=1.0,
    )
    film = store.film(condition, 0)
    true = store.truth(condition, 0)
    names = Scene.read(scene, physics=check_physics).fiducial_names
    seen = film.positions[:, [film.fiducial_names.index(name) for name in names]]
    assert np.isfinite(seen).mean() > 0.85
    # Registration lays the beads, which are 0.2 mm off their places, onto the scene's layout; what is left is their tilt.
    error = seen - true
    assert np.nanstd(error - np.nanmean(error, axis=(0, 1))) < 0.25e-3
    moved, wanted = seen - seen[0], true - true[0]
    assert np.sqrt(np.nanmean((moved - wanted) ** 2)) < 0.06e-3
    assert np.abs(wanted).max() > 15e-3
    # The gripper's motion is the commanded one, not the one that was made.
    assert np.allclose(film.actions[0].translation, condition.actions()[0].translation, atol=1e-9)
    again = store.film(condition, 0)
    assert again.fingerprint() == film.fingerprint()
    assert isinstance(again, Measurement)
    assert len(list((tmp_path / "filmed").iterdir())) == 1
