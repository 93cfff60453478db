"""From a point's pixels in two images to its place, with a covariance.

`linear` is the direct linear transformation (Hartley & Zisserman, Multiple View Geometry, 12.2); `triangulate` goes on from it to
the place of greatest likelihood under normal errors of the pixels (ibid. 12.3), whose inverse Hessian is the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.vision.camera import Camera, Cameras

Array = NDArray[np.float64]

_STEPS, _EXACT = 20, 1e-13


@dataclass(frozen=True)
class Points:
    """Places in the frame of the left camera.

    Attributes:
        positions: shape (n, 3), m; NaN where a pixel is NaN or the rays do not meet in front of the cameras.
        covariance: of each, shape (n, 3, 3), m^2.
        misfit: chi-square of each from the four coordinates of its pixels, with one degree of freedom, shape (n,).
    """

    positions: Array
    covariance: Array
    misfit: Array


def linear(cameras: Cameras, left: Array, right: Array) -> Array:
    """Places (n, 3), m, in the left camera's frame from pixels (n, 2) in both images, by homogeneous least squares in pixels."""
    flat = [_flat(camera, pixels) for camera, pixels in ((cameras.left, left), (cameras.right, right))]
    rows = [
        pixel[:, axis, None] * matrix[2] - matrix[axis]
        for pixel, matrix in zip(flat, _matrices(cameras), strict=True)
        for axis in (0, 1)
    ]
    system = np.stack(rows, axis=1)
    good = np.isfinite(system).all(axis=(1, 2))
    positions = np.full((len(system), 3), np.nan)
    if good.any():
        last = np.linalg.svd(system[good])[2][:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            positions[good] = last[:, :3] / last[:, 3:]
    return positions


def triangulate(
    cameras: Cameras,
    left: Array,
    right: Array,
    left_covariance: Array | None = None,
    right_covariance: Array | None = None,
) -> Points:
    """Most likely places of points, and how sure they are.

    Args:
        left, right: pixels, shape (n, 2); rows with NaN stay NaN.
        left_covariance, right_covariance: of the pixels, shape (n, 2, 2), px^2; one pixel in each direction by default.
    """
    start = linear(cameras, left, right)
    count = len(start)
    one = np.broadcast_to(np.eye(2), (count, 2, 2))
    weights = [
        np.asarray(np.linalg.inv(one if covariance is None else covariance))
        for covariance in (left_covariance, right_covariance)
    ]
    flat = [_flat(camera, pixels) for camera, pixels in ((cameras.left, left), (cameras.right, right))]
    positions, covariance = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    misfit = np.full(count, np.nan)
    depth = np.stack([start @ matrix[2, :3] + matrix[2, 3] for matrix in _matrices(cameras)])
    good = np.flatnonzero(np.isfinite(start).all(axis=1) & (depth > 0).all(axis=0))
    if len(good) == 0:
        return Points(positions, covariance, misfit)
    here = start[good]
    for _ in range(_STEPS):
        gradient, hessian, misfit[good] = _system(cameras, here, [f[good] for f in flat], [w[good] for w in weights])
        step = np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0]
        here = here + step
        if np.abs(step).max() <= _EXACT * np.abs(here).max():
            break
    positions[good], covariance[good] = here, np.linalg.inv(hessian)
    return Points(positions, covariance, misfit)


def epipolar_distance(cameras: Cameras, left: Array, right: Array) -> Array:
    """How far pixels (m, 2) of the right image are from the epipolar lines of pixels (n, 2) of the left one, shape (n, m), px.

    The distance is measured in the image without distortion.
    """
    shift = cameras.translation
    cross = np.array([[0, -shift[2], shift[1]], [shift[2], 0, -shift[0]], [-shift[1], shift[0], 0]])
    essential = cross @ cameras.rotation
    rays = [
        np.column_stack([c.undistort(p), np.ones(len(p))]) for c, p in ((cameras.left, left), (cameras.right, right))
    ]
    lines = rays[0] @ essential.T
    return np.asarray(np.abs(lines @ rays[1].T) / np.linalg.norm(lines[:, :2], axis=1)[:, None] * cameras.right.focal)


def _flat(camera: Camera, pixels: Array) -> Array:
    """Pixels (n, 2) as a camera without distortion would show them."""
    rays = camera.undistort(pixels)
    return np.asarray(np.column_stack([rays, np.ones(len(rays))]) @ camera.matrix[:2].T)


def _matrices(cameras: Cameras) -> tuple[Array, Array]:
    """Projection matrices (3, 4) of both cameras for points in the left one's frame."""
    placed = np.column_stack([cameras.rotation, cameras.translation])
    return cameras.left.matrix @ np.eye(3, 4), cameras.right.matrix @ placed


def _system(cameras: Cameras, points: Array, flat: list[Array], weights: list[Array]) -> tuple[Array, Array, Array]:
    """Gradient (n, 3) and Hessian (n, 3, 3) of a Gauss-Newton step, and chi-square (n,)."""
    gradient, hessian, chi2 = np.zeros((len(points), 3)), np.zeros((len(points), 3, 3)), np.zeros(len(points))
    for matrix, pixel, weight in zip(_matrices(cameras), flat, weights, strict=True):
        image = points @ matrix[:, :3].T + matrix[:, 3]
        shown = image[:, :2] / image[:, 2:]
        slope = (matrix[None, :2, :3] - shown[:, :, None] * matrix[None, 2:, :3]) / image[:, 2, None, None]
        left = pixel - shown
        weighted = np.einsum("nij,nj->ni", weight, left)
        gradient += np.einsum("nji,nj->ni", slope, weighted)
        hessian += np.einsum("nji,njk,nkl->nil", slope, weight, slope)
        chi2 += np.einsum("ni,ni->n", left, weighted)
    return gradient, hessian, chi2
