"""The rigid motion between the frame of the cameras and that of the body.

The motion takes a point x in the left camera's frame to scale R x + t in the body's. It is fitted to the beads at rest with
weights from their covariances (start: Kabsch, Acta Cryst. A 32, 1976; Umeyama, IEEE PAMI 13, 1991); the inverse of the normal
matrix is its covariance. An error of it is common to all points and steps: it is kept as such, and is no part of their noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.measurement.frame_error import FrameError, slopes
from bcid.vision.triangulate import Points

Array = NDArray[np.float64]

_STEPS, _EXACT = 50, 1e-14


@dataclass(frozen=True)
class Registration:
    """From the left camera's frame to the body's.

    Attributes:
        rotation, translation, scale: body = scale rotation camera + translation; shapes (3, 3), (3,) m.
        error: what is not known of it, about the middle of the beads, in the body's frame; none of a scale that is fixed.
        rms: of the beads at rest against the layout, m.
        residuals: of each bead, shape (beads, 3), m, in the body's frame; NaN where one was not seen.
        free_scale: the scale when it is fitted too, and its standard deviation.
    """

    rotation: Array
    translation: Array
    scale: float
    error: FrameError
    rms: float
    residuals: Array
    free_scale: tuple[float, float]

    def to_body(self, points: Array) -> Array:
        """Points (..., 3), m, of the camera's frame in the body's."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def vectors_to_camera(self, vectors: Array) -> Array:
        """Displacements (..., 3), m, of the body's frame in the camera's."""
        return np.asarray(vectors @ self.rotation / self.scale)

    def turned(self, covariance: Array) -> Array:
        """Covariances (..., 3, 3), m^2, of points in the camera's frame, in the body's."""
        return np.asarray(self.scale**2 * self.rotation @ covariance @ self.rotation.T)


def register(points: Points, layout: Array, layout_sigma: float = 0.0, scale: bool = False) -> Registration:
    """Fit the motion to beads at rest.

    Args:
        points: in the camera's frame, in the order of the layout; NaN for beads that were not seen.
        layout: rest positions in the body's frame, shape (beads, 3), m.
        layout_sigma: standard deviation of a coordinate of it, m. Where what is left is larger than all that, the covariance is
            scaled up to it.
        scale: whether to fit a scale as well.
    """
    seen = np.isfinite(points.positions).all(axis=1)
    camera, body, spread = points.positions[seen], layout[seen], points.covariance[seen]
    fixed = _fit(camera, body, spread, layout_sigma, False)
    free = _fit(camera, body, spread, layout_sigma, True)
    rotation, translation, factor, covariance = free if scale else fixed
    residuals = np.full(layout.shape, np.nan)
    residuals[seen] = factor * camera @ rotation.T + translation - body
    return Registration(
        rotation,
        translation,
        factor,
        FrameError(body.mean(axis=0), covariance),
        float(np.sqrt(np.mean(residuals[seen] ** 2))),
        residuals,
        (free[2], float(free[2] * np.sqrt(free[3][6, 6]))),
    )


def _fit(camera: Array, body: Array, spread: Array, sigma: float, scale: bool) -> tuple[Array, Array, float, Array]:
    """Rotation, translation, scale, covariance (7, 7) about the middle of the beads in the body's frame."""
    from scipy.spatial.transform import Rotation

    rotation, translation, factor = rigid(camera, body, scale)
    middle = body.mean(axis=0)
    count = 7 if scale else 6
    for _ in range(_STEPS):
        moved = factor * camera @ rotation.T + translation
        weight = np.linalg.inv(factor**2 * rotation @ spread @ rotation.T + (sigma**2 + 1e-18) * np.eye(3))
        slope = slopes(moved - middle)[:, :, :count]
        normal = np.einsum("nji,njk,nkl->il", slope, weight, slope)
        left = body - moved
        step = np.linalg.solve(normal, np.einsum("nji,njk,nk->i", slope, weight, left))
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        grow = np.exp(step[6]) if scale else 1.0
        rotation, factor = turn @ rotation, float(factor * grow)
        translation = grow * turn @ (translation - middle) + middle + step[3:6]
        if np.abs(step).max() < _EXACT:
            break
    left = body - (factor * camera @ rotation.T + translation)
    freedom = max(3 * len(body) - count, 1)
    excess = float(np.einsum("ni,nij,nj->", left, weight, left)) / freedom
    covariance = np.zeros((7, 7))
    covariance[:count, :count] = np.linalg.inv(normal) * max(excess, 1.0)
    return rotation, translation, factor, covariance


def rigid(source: Array, target: Array, scale: bool = False) -> tuple[Array, Array, float]:
    """Rotation (..., 3, 3), translation (..., 3) and scale that take points (..., n, 3) closest to others, all alike weighted."""
    first, second = source.mean(axis=-2, keepdims=True), target.mean(axis=-2, keepdims=True)
    u, sizes, v = np.linalg.svd(np.swapaxes(target - second, -1, -2) @ (source - first))
    sign = np.ones(sizes.shape)
    sign[..., 2] = np.sign(np.linalg.det(u @ v))
    rotation = (u * sign[..., None, :]) @ v
    factor = 1.0
    if scale:
        factor = float(np.sum(sizes * sign) / np.sum((source - first) ** 2))
    translation = (second - factor * first @ np.swapaxes(rotation, -1, -2))[..., 0, :]
    return rotation, translation, factor
