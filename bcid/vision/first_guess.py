"""Where the adjustment of two cameras starts: each camera from its boards alone (Zhang, IEEE PAMI 22, 2000), then the place of
the right camera that most pairs agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.vision.adjustment import LENSES, Adjustment, CameraEstimate, Size, camera_matrix, turned
from bcid.vision.calibrations.projections import decompose
from bcid.vision.corners import Corners

Array = NDArray[np.float64]
# Rotation (3, 3) and place (3,), m, of a board in a camera's frame.
Placed = tuple[Array, Array]

# Pairs from which a camera is found.
_PAIRS = 20

# Points are solid, not flat, from this ratio of their smallest extent to their largest: a transformation can be found then.
_SOLID = 0.05


def first_guess(
    corners: Sequence[Corners], sizes: tuple[Size, Size], distortion: int
) -> tuple[CameraEstimate, list[Corners], list[int]]:
    """A state to start from, the corners in one order for both cameras, and the pairs whose order was turned in the right image.

    Args:
        sizes: width and height of the left and of the right images, px.
        distortion: coefficients of the lens, see `LENSES`; all are zero here.
    """
    inner = np.zeros((2, 4 + max((k + 1 for k in LENSES[distortion]), default=0)))
    for side in range(2):
        inner[side, :4] = _alone(corners, side, sizes[side])
    left = [_pose(c.board, c.left, inner[0]) for c in corners]
    orders = [[np.arange(len(c)), *([] if c.names else _symmetries(c.board))] for c in corners]
    right = [
        [_pose(c.board, c.right[order], inner[1]) for order in some] for c, some in zip(corners, orders, strict=True)
    ]
    rotation, translation, chosen = _agreed(left, right)
    ordered = [
        replace(c, right=c.right[some[k]]) if k else c for c, some, k in zip(corners, orders, chosen, strict=True)
    ]
    flipped = [c.number for c, k in zip(corners, chosen, strict=True) if k]
    other = [
        (rotation.T @ turn, rotation.T @ (place - translation))
        for turn, place in (poses[k] for poses, k in zip(right, chosen, strict=True))
    ]
    poses = []
    for pair, two in zip(ordered, zip(left, other, strict=True), strict=True):
        adjustment = Adjustment([pair], distortion)
        tried = [CameraEstimate(inner, rotation, translation, t[None], p[None]) for t, p in two]
        # A small board looks nearly the same from its mirrored tilt: the camera that saw it better decides.
        poses.append(min(tried, key=adjustment.cost))
    state = CameraEstimate(
        inner, rotation, translation, np.vstack([s.turns for s in poses]), np.vstack([s.places for s in poses])
    )
    return state, ordered, flipped


def _alone(corners: Sequence[Corners], side: int, size: Size) -> list[float]:
    """fx, fy, cx, cy of one camera, without distortion and with the principal point in the middle, px."""
    import cv2

    solid = [c for c in corners if is_solid(c.board)]
    chosen = solid or [_laid_flat(c) for c in corners]
    chosen = [chosen[i] for i in np.unique(np.linspace(0, len(chosen) - 1, _PAIRS).round().astype(int))]
    boards = [c.board.astype(np.float32) for c in chosen]
    pixels = [(c.right if side else c.left).astype(np.float32)[:, None] for c in chosen]
    flags = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_ZERO_TANGENT_DIST
    flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    focal, middle = 1.5 * max(size), [(size[0] - 1) / 2, (size[1] - 1) / 2]
    start = None
    if solid:
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
        start = camera_matrix(np.array([*_lengths(solid, side, focal), *middle]))
    try:
        matrix = np.asarray(cv2.calibrateCamera(boards, pixels, size, start, None, flags=flags)[1])
    except cv2.error:
        return [focal, focal, *middle]
    lengths = matrix[[0, 1], [0, 1]]
    sensible = np.isfinite(lengths).all() and lengths.min() > 0.1 * max(size) and lengths.max() < 200 * max(size)
    return [*map(float, lengths), *middle] if sensible else [focal, focal, *middle]


def _lengths(solid: Sequence[Corners], side: int, otherwise: float) -> Array:
    """fx and fy, px, that views of solid objects tell: the median."""
    found = [focal_lengths(c.board, c.right if side else c.left) for c in solid]
    known = [lengths for lengths in found if lengths is not None and np.isfinite(lengths).all()]
    return np.asarray(np.median(known, axis=0)) if known else np.full(2, otherwise)


def _laid_flat(corners: Corners) -> Corners:
    """A board in its own plane, z being 0, as OpenCV needs it to start from."""
    if not corners.board[:, 2].any():
        return corners
    away = corners.board - corners.board.mean(axis=0)
    axes = np.linalg.svd(away, full_matrices=False)[2]
    axes[2] *= np.sign(np.linalg.det(axes))
    return replace(corners, board=away @ axes.T * [1, 1, 0])


def _pose(board: Array, pixels: Array, inner: Array) -> Placed:
    """Rotation and place of a board in a camera's frame."""
    import cv2

    try:
        # What is nearly flat, or in another plane than z = 0, is not for the other method.
        how = cv2.SOLVEPNP_SQPNP if board[:, 2].any() else cv2.SOLVEPNP_ITERATIVE
        image = np.ascontiguousarray(pixels[:, None])
        _, turn, place = cv2.solvePnP(board[:, None], image, camera_matrix(inner), None, flags=how)
    except cv2.error:
        return np.eye(3), np.array([0.0, 0.0, 1.0])
    return turned(turn), np.asarray(place).ravel()


def _symmetries(board: Array) -> list[NDArray[np.intp]]:
    """Orders of the corners (n, 3) that a turn of the board in its plane makes, as the half turn of a chessboard."""
    middle = (board.max(axis=0) + board.min(axis=0))[:2] / 2
    flat = board[:, :2] - middle
    found = []
    for turn in ([[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]):
        gaps = np.linalg.norm((flat @ np.array(turn).T)[:, None] - flat[None], axis=2)
        order = gaps.argmin(axis=1)
        if gaps.min(axis=1).max() < 1e-6 * np.abs(flat).max():
            found.append(order)
    return found


def _agreed(left: list[Placed], right: list[list[Placed]]) -> tuple[Array, Array, list[int]]:
    """The place of the right camera that most pairs agree on, and the order of each pair's corners that gives it.

    A chessboard looks the same after half a turn, so each image may count its corners from the other end. The same end in both
    images gives one place of the cameras in all pairs; different ends do not.
    """
    owner = np.array([i for i, poses in enumerate(right) for _ in poses])
    kinds = np.array([k for poses in right for k in range(len(poses))])
    turns = np.array([turn @ left[i][0].T for i, poses in enumerate(right) for turn, _ in poses])
    places = np.array([p for poses in right for _, p in poses]) - np.einsum(
        "nij,nj->ni", turns, np.array([left[i][1] for i in owner])
    )
    depth = float(np.median([abs(place[2]) for _, place in left])) or 1.0
    angles = np.arccos(np.clip((np.einsum("aij,bij->ab", turns, turns) - 1) / 2, -1, 1))
    gaps = angles + np.linalg.norm(places[:, None] - places[None], axis=2) / depth
    # To change the order is the exception: it must fit clearly better.
    weighted = gaps * np.where(kinds == 0, 1.0, 2.0)[None]
    best = np.array([weighted[:, owner == i].min(axis=1) for i in range(len(left))])
    winner = int(np.argmin(np.minimum(best, 0.3).sum(axis=0) + 1e-6 * (kinds > 0)))
    chosen = [int(kinds[owner == i][np.argmin(weighted[winner, owner == i])]) for i in range(len(left))]
    return turns[winner], places[winner], chosen


def relief(points: Array) -> float:
    """Smallest over largest extent (singular value) of points (n, 3): 0 for a plane."""
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(sizes[2] / sizes[0]) if sizes[0] > 0 else 0.0


def is_solid(points: Array) -> bool:
    """Whether one view of points (n, 3) tells what the camera is."""
    return len(points) >= 6 and points.shape[1:] == (3,) and bool(np.isfinite(points).all()) and relief(points) > _SOLID


def resect(points: Array, pixels: Array) -> Array:
    """Projection matrix (3, 4) from points (n, 3) and pixels (n, 2); at least six, not in a plane."""
    space, image = _normal(points), _normal(pixels)
    x = np.column_stack([points, np.ones(len(points))]) @ space.T
    u = np.column_stack([pixels, np.ones(len(pixels))]) @ image.T
    nought = np.zeros_like(x)
    system = np.vstack([np.hstack([x, nought, -u[:, :1] * x]), np.hstack([nought, x, -u[:, 1:2] * x])])
    found = np.linalg.svd(system)[2][-1].reshape(3, 4)
    return np.asarray(np.linalg.solve(image, found @ space))


def focal_lengths(points: Array, pixels: Array) -> Array | None:
    """fx and fy, px, of the camera that saw points at pixels; None where they tell none."""
    parts = decompose(resect(points, pixels))
    return None if parts is None else np.diag(parts[0])[:2]


def is_mirrored(corners: Corners) -> bool:
    """Whether both images show a solid object as a mirror would: the cameras would have to look away from it."""
    if not is_solid(corners.board):
        return False
    middle = corners.board.mean(axis=0)
    parts = [decompose(resect(corners.board, pixels)) for pixels in (corners.left, corners.right)]
    return all(part is not None and float(part[1][2] @ middle + part[2][2]) < 0 for part in parts)


def _normal(points: Array) -> Array:
    """The map of homogeneous points to ones with their middle at the origin, at a distance of the root of their dimension."""
    count = points.shape[1]
    middle = points.mean(axis=0)
    scale = np.sqrt(count) / max(float(np.linalg.norm(points - middle, axis=1).mean()), 1e-300)
    made = np.eye(count + 1)
    made[:count, :count] *= scale
    made[:count, count] = -scale * middle
    return made
