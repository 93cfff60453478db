"""Pictures of a calibration board, as two cameras take them: the pattern is looked up where each pixel's ray meets the board."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.scene.rotation import as_rotation, from_vector
from bcid.vision.board import CHESSBOARD, Board
from bcid.vision.camera import SIDES, Camera, Cameras
from bcid.vision.images import Image
from bcid.vision.track import working_distance
from validation.rendering.lens import Lens
from validation.rendering.rig import Pose

Array = NDArray[np.float64]
# Pixels of the pattern in a square, rays across a pixel of the camera, and their blur, in pixels of the camera.
_FINE, _RAYS, _BLUR = 64, 2, 0.5
# Greys of the board's black and white, and of what lies behind it; standard deviation of the noise, grey levels.
_BLACK, _WHITE, _BEHIND, _NOISE = 30, 220, 110, 2.0
# How far the board is tilted at most, deg, and how far its middle is from where the cameras look, as parts of the distance.
_TILT, _AWAY, _NEARER = 30.0, 0.11, 0.1


def photograph_board(cameras: Cameras, board: Board, folder: Path, count: int, random_state: int = 0) -> list[Pose]:
    """Write `count` pairs of images of a chessboard into folder/left and folder/right, at the distance where the axes meet.

    Returns the poses of the board in the left camera's frame.

    Raises:
        InputError: the board is no chessboard, or a camera has no size.
    """
    import cv2

    if board.kind != CHESSBOARD:
        raise InputError(f"board '{board}': only a {CHESSBOARD} can be photographed")
    random = np.random.default_rng(random_state)
    pattern, corner = _pattern(board)
    places = {"left": (np.eye(3), np.zeros(3)), "right": (cameras.rotation, cameras.translation)}
    lenses = {side: _finer(side, getattr(cameras, side)) for side in SIDES}
    poses = [_pose(board, working_distance(cameras), random) for _ in range(count)]
    for side in SIDES:
        (folder / side).mkdir(parents=True)
        turn, shift = places[side]
        for number, (rotation, translation) in enumerate(poses):
            seen = _seen(pattern, corner, board.square, lenses[side], (turn @ rotation, turn @ translation + shift))
            noisy = np.clip(np.rint(seen + random.normal(0, _NOISE, seen.shape)), 0, 255).astype(np.uint8)
            cv2.imwrite(str(folder / side / f"{number:04d}.png"), noisy)
    return poses


def _pattern(board: Board) -> tuple[Image, Array]:
    """The board with a white rim of one square, and where on it the middle of the first pixel lies, in squares."""
    y, x = np.mgrid[0 : (board.rows + 1) * _FINE, 0 : (board.columns + 1) * _FINE] // _FINE
    inside = np.where((x + y) % 2, _WHITE, _BLACK).astype(np.uint8)
    return np.pad(inside, _FINE, constant_values=_WHITE), np.full(2, 0.5 / _FINE - 2)


def _finer(side: str, camera: Camera) -> Lens:
    """The lens with several rays across each pixel; their mean is at the pixel's middle."""
    scale = np.array([[_RAYS, 0, (_RAYS - 1) / 2], [0, _RAYS, (_RAYS - 1) / 2], [0, 0, 1.0]])
    size = (camera.size[0] * _RAYS, camera.size[1] * _RAYS)
    return Lens(side, replace(camera, matrix=scale @ camera.matrix, size=size))


def _pose(board: Board, distance: float, random: np.random.Generator) -> Pose:
    """A pose in which the whole board is in view of both cameras, tilted any way."""
    rotation = as_rotation(from_vector(np.append(random.uniform(-_TILT, _TILT, 2), random.uniform(-5, 5)))).as_matrix()
    middle = (board.points.max(axis=0) + board.points.min(axis=0)) / 2
    aside = random.uniform(-_AWAY, _AWAY, 2) * distance
    centre = np.append(aside, distance * (1 + random.uniform(-_NEARER, _NEARER)))
    return rotation, centre - rotation @ middle


def _seen(pattern: Image, corner: Array, square: float, lens: Lens, pose: Pose) -> Array:
    """Greys of the board at a pose in a camera's frame."""
    import cv2

    rotation, translation = pose
    height, width = lens.rays.shape[:2]
    directions = np.concatenate([lens.rays, np.ones((height, width, 1))], axis=2).reshape(-1, 3)
    # A ray meets the plane where it is a multiple of rotation[:, :2] (x, y) + translation.
    on_board = np.linalg.solve(np.column_stack([rotation[:, :2], translation]), directions.T).T
    places = (on_board[:, :2] / on_board[:, 2:] / square - corner) * _FINE
    maps = places.reshape(height, width, 2).astype(np.float32)
    drawn = cv2.remap(pattern, maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(_BEHIND,) * 4)
    blurred = cv2.GaussianBlur(drawn, (0, 0), _BLUR * _RAYS)
    return np.asarray(cv2.resize(blurred, (width // _RAYS, height // _RAYS), interpolation=cv2.INTER_AREA), dtype=float)
