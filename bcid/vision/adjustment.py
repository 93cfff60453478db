"""Bundle adjustment: lenses, places of two cameras and of every board by least squares of the distances between corners found
and corners projected (Triggs et al., 2000)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems
from bcid.vision.camera import Camera
from bcid.vision.corners import Corners

Array = NDArray[np.float64]
Size = tuple[int, int]

MATRIX = ("fx", "fy", "cx", "cy")
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
# Coefficients of the lens that are found, by how many are asked for: places in COEFFICIENTS.
LENSES = {0: (), 2: (0, 1), 4: (0, 1, 2, 3), 5: (0, 1, 2, 3, 4), 8: (0, 1, 2, 3, 4, 5, 6, 7)}
# Pairs below which little is known of the scatter between them.
FEW = 10
# Levenberg-Marquardt: steps at most, first damping, when to give up, and the relative gain that ends it.
_STEPS, _DAMPING, _STUCK, _GAIN = 200, 1e-4, 1e12, 1e-13


def check_lens(distortion: int, problems: Problems) -> None:
    """Note a number of coefficients that does not exist."""
    if distortion not in LENSES:
        problems.add("distortion", f"{distortion} coefficients of the lens: expected {', '.join(map(str, LENSES))}")


@dataclass(frozen=True)
class CameraEstimate:
    """What the adjustment finds.

    Attributes:
        inner: fx, fy, cx, cy (px) and OpenCV's coefficients of the two lenses, shape (2, 4 + coefficients).
        rotation, translation: from the left to the right camera, shapes (3, 3) and (3,), m.
        turns, places: of the boards in the frame of the left camera, shapes (pairs, 3, 3) and (pairs, 3), m.
    """

    inner: Array
    rotation: Array
    translation: Array
    turns: Array
    places: Array

    def camera(self, side: int, size: Size) -> Camera:
        """One camera; zeros behind the last coefficient make the number one that OpenCV allows."""
        lens = list(map(float, self.inner[side, 4:]))
        allowed = next(n for n in (0, 4, 5, 8) if n >= len(lens))
        return Camera(camera_matrix(self.inner[side]), np.array(lens + [0.0] * (allowed - len(lens))), size)

    def only(self, pairs: NDArray[np.bool_]) -> CameraEstimate:
        """The same with some of the boards."""
        return replace(self, turns=self.turns[pairs], places=self.places[pairs])


@dataclass(frozen=True)
class _Blocks:
    """Normal equations of each pair: shared unknowns s, the pair's own six p; matrices ss, sp, pp and right sides s, p."""

    ss: Array
    sp: Array
    pp: Array
    s: Array
    p: Array

    def reduced(self, damping: float = 0.0) -> tuple[Array, Array]:
        """Matrices (pairs, s, s) and right sides (pairs, s) once each pair's own unknowns are eliminated (Schur)."""
        weights = np.linalg.solve(_damped(self.pp, damping), np.swapaxes(self.sp, 1, 2))
        return self.ss - self.sp @ weights, self.s - np.einsum("mks,mk->ms", weights, self.p)


class Adjustment:
    """Least squares over corners of several pairs.

    Attributes:
        corners: of the pairs.
        distortion: how many coefficients of the lens are found, see `LENSES`.
        board, pixels: all corners, shapes (corners, 3), m, and (2, corners, 2), px.
        ends: where in them each pair begins, and the end of the last.
        free: places in `CameraEstimate.inner` of what is found of each camera.
    """

    def __init__(self, corners: Sequence[Corners], distortion: int) -> None:
        self.corners = tuple(corners)
        self.distortion = distortion
        self.board = np.vstack([c.board for c in corners])
        self.pixels = np.stack([np.vstack([c.left for c in corners]), np.vstack([c.right for c in corners])])
        self.ends = np.cumsum([0, *(len(c) for c in corners)])
        self.pair = np.repeat(np.arange(len(corners)), [len(c) for c in corners])
        self.free = [0, 1, 2, 3, *(4 + k for k in LENSES[distortion])]
        self.shared = 2 * len(self.free) + 6

    def residuals(self, state: CameraEstimate) -> Array:
        """Found minus projected, shape (corners, 4): left u, v, right u, v, px."""
        left, right = (_projected(state.inner[k], points)[0] for k, points in enumerate(self.points(state)))
        return np.hstack([self.pixels[0] - left, self.pixels[1] - right])

    def cost(self, state: CameraEstimate) -> float:
        """Sum of squares, px^2; infinite where the cameras are none."""
        if min(state.inner[:, :2].min(), self.points(state)[0][:, 2].min()) <= 0:
            return math.inf
        cost = float(np.sum(self.residuals(state) ** 2))
        return cost if math.isfinite(cost) else math.inf

    def blocks(self, state: CameraEstimate) -> _Blocks:
        """Normal equations at a state; rotations change by small turns from the left."""
        seen = self.points(state)
        free, count = self.free, len(self.free)
        turned = np.einsum("nij,nj->ni", state.turns[self.pair], self.board)
        own = np.zeros((len(self.board), 3, 6))
        own[:, :, :3], own[:, :, 3:] = -_cross(turned), np.eye(3)
        shared = np.zeros((len(self.board), 4, self.shared))
        pose = np.zeros((len(self.board), 4, 6))
        errors = np.zeros((len(self.board), 4))
        for side, points in enumerate(seen):
            rows = slice(2 * side, 2 * side + 2)
            pixels, by_point, by_inner = _projected(state.inner[side], points)
            errors[:, rows] = self.pixels[side] - pixels
            shared[:, rows, side * count : (side + 1) * count] = by_inner[:, :, free]
            if side == 1:
                shared[:, rows, -6:-3] = by_point @ -_cross(points - state.translation)
                shared[:, rows, -3:] = by_point
                by_point = by_point @ state.rotation
            pose[:, rows] = by_point @ own
        ss, sp, pp, s, p = [], [], [], [], []
        for a, b in itertools.pairwise(self.ends):
            js, jp, r = shared[a:b].reshape(-1, self.shared), pose[a:b].reshape(-1, 6), errors[a:b].ravel()
            ss.append(js.T @ js)
            sp.append(js.T @ jp)
            pp.append(jp.T @ jp)
            s.append(js.T @ r)
            p.append(jp.T @ r)
        return _Blocks(*map(np.array, (ss, sp, pp, s, p)))

    def solve(self, state: CameraEstimate, shared: bool = True) -> CameraEstimate:
        """Levenberg and Marquardt's method from a state; with `shared` False only the boards move."""
        cost, damping = self.cost(state), _DAMPING
        blocks = self.blocks(state)
        for _ in range(_STEPS):
            moved = self._moved(state, blocks, damping, shared)
            less = math.inf if moved is None else self.cost(moved)
            if moved is None or not less < cost:
                damping *= 10
                if damping > _STUCK:
                    break
                continue
            gain, state, cost = cost - less, moved, less
            if gain <= _GAIN * cost:
                break
            damping = max(damping / 10, 1e-12)
            blocks = self.blocks(state)
        return state

    def pair_errors(self, state: CameraEstimate) -> Array:
        """RMS distance of each pair's corners in both images, shape (pairs), px."""
        squares = np.sum(self.residuals(state) ** 2, axis=1)
        return np.array([math.sqrt(squares[a:b].mean() / 2) for a, b in itertools.pairwise(self.ends)])

    def covariance(self, state: CameraEstimate) -> Array:
        """Of the shared unknowns, shape (s, s); infinite where the boards do not determine them.

        From the jackknife over pairs (Efron and Stein, Ann. Stat. 9, 1981), each pair being left out in one Gauss-Newton step. It
        takes errors that all corners of a pair have in common (a board that is not flat, an image that is blurred) for what they
        are. With fewer than `FEW` pairs, where the jackknife says little, from the Jacobian and the scatter of the residuals.
        """
        matrices, sides = self.blocks(state).reduced()
        total, pairs = matrices.sum(axis=0), len(self.corners)
        scale = 1 / np.sqrt(np.maximum(np.diag(total), 1e-300))
        matrices, sides = matrices * np.outer(scale, scale), sides * scale
        total = matrices.sum(axis=0)
        unknown = np.full_like(total, math.inf)
        try:
            if np.linalg.cond(total) > 1e15:
                return unknown
            if pairs < FEW:
                spare = self.pixels.size - self.shared - 6 * pairs
                found = np.linalg.inv(total) * self.cost(state) / max(spare, 1)
            else:
                changes = np.linalg.solve(total - matrices, -sides[:, :, None])[:, :, 0]
                changes -= changes.mean(axis=0)
                found = (pairs - 1) / pairs * changes.T @ changes
        except np.linalg.LinAlgError:
            return unknown
        return np.asarray(found * np.outer(scale, scale))

    def points(self, state: CameraEstimate) -> tuple[Array, Array]:
        """Corners in the frames of the two cameras, m."""
        left = np.einsum("nij,nj->ni", state.turns[self.pair], self.board) + state.places[self.pair]
        return left, left @ state.rotation.T + state.translation

    def _moved(self, state: CameraEstimate, blocks: _Blocks, damping: float, shared: bool) -> CameraEstimate | None:
        try:
            step = np.zeros(self.shared)
            if shared:
                matrices, sides = blocks.reduced(damping)
                total = matrices.sum(axis=0) + damping * np.diag(np.diag(blocks.ss.sum(axis=0)))
                scale = 1 / np.sqrt(np.maximum(np.diag(total), 1e-300))
                step = scale * np.linalg.solve(total * np.outer(scale, scale), scale * sides.sum(axis=0))
            rest = blocks.p - np.einsum("msp,s->mp", blocks.sp, step)
            own = np.linalg.solve(_damped(blocks.pp, damping), rest[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            return None
        if not (np.isfinite(step).all() and np.isfinite(own).all()):
            return None
        inner = state.inner.copy()
        inner[:, self.free] += step[:-6].reshape(2, -1)
        turns = np.array([turned(w) @ turn for w, turn in zip(own[:, :3], state.turns, strict=True)])
        return CameraEstimate(
            inner, turned(step[-6:-3]) @ state.rotation, state.translation + step[-3:], turns, state.places + own[:, 3:]
        )


def _damped(matrices: Array, damping: float) -> Array:
    """Matrices (m, k, k) with their diagonals made larger."""
    return np.asarray(matrices * (1 + damping * np.eye(matrices.shape[-1])))


def _projected(inner: Array, points: Array) -> tuple[Array, Array, Array]:
    """Pixels (n, 2) of points (n, 3) in a camera's frame, and derivatives by the point (n, 2, 3) and by `inner` (n, 2, ...)."""
    import cv2

    # OpenCV knows no fewer than four coefficients.
    lens = np.concatenate([inner[4:], np.zeros(max(0, 8 - len(inner)))])
    pixels, jacobian = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera_matrix(inner), lens)
    jacobian = np.asarray(jacobian).reshape(len(points), 2, -1)
    return pixels.reshape(-1, 2), jacobian[:, :, 3:6], jacobian[:, :, 6 : 6 + len(inner)]


def _cross(vectors: Array) -> Array:
    """Matrices (n, 3, 3) that multiply like the cross product with vectors (n, 3)."""
    x, y, z = vectors.T
    o = np.zeros_like(x)
    return np.array([[o, -z, y], [z, o, -x], [-y, x, o]]).transpose(2, 0, 1)


def turned(vector: Array) -> Array:
    """Rotation (3, 3) about a vector (3,) by its length, rad."""
    import cv2

    return np.asarray(cv2.Rodrigues(np.asarray(vector, dtype=float))[0])


def camera_matrix(inner: Array) -> Array:
    """OpenCV's matrix (3, 3) of a camera from its fx, fy, cx, cy, ..., px."""
    fx, fy, cx, cy = inner[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
