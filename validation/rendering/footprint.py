"""The pixels around a bead in an image, traced ray by ray through the lens: no rasterisation shifts the bead's middle."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bcid.vision.camera import Camera
from validation.rendering.appearance import Appearance

Array = NDArray[np.float64]
Grey = NDArray[np.float32]


class Footprint:
    """The square of pixels around a bead, and the directions of the points that each pixel is divided into.

    Args:
        corner: its upper left pixel (u, v).
        axis: pixels counted from the corner, shape (m,), the ends being the borders of the square.
        knots: directions at m x m pixels `axis`, v first, shape (m, m, 2).
        supersampling: points across a pixel.
    """

    def __init__(self, corner: NDArray[np.int64], axis: Array, knots: Array, supersampling: int) -> None:
        from scipy.interpolate import RectBivariateSpline

        self.corner, self.width = corner, round(axis[-1] - axis[0])
        fine = (np.arange(self.width * supersampling) + 0.5) / supersampling - 0.5
        self._rays = np.stack([RectBivariateSpline(axis, axis, knots[..., i])(fine, fine) for i in (0, 1)], axis=-1)

    @classmethod
    def of(cls, camera: Camera, ball: Array, pixel: Array, appearance: Appearance) -> Footprint | None:
        """That of a bead at `ball` (3,), camera frame, whose centre is seen at `pixel` (2,); None if it is not in the image."""
        if not np.isfinite(pixel).all() or np.linalg.norm(ball) <= appearance.diameter:
            return None
        # Off the axis and where the lens stretches, beads are larger than focal length and depth say.
        reach = math.ceil(1.5 * camera.focal * appearance.radius * np.linalg.norm(ball) / ball[2] ** 2) + 1
        if (pixel < -reach).any() or (pixel > np.array(camera.size) + reach).any():
            return None
        corner = np.rint(pixel).astype(int) - reach
        axis = np.linspace(-0.5, 2 * reach + 0.5, 6)
        v, u = np.meshgrid(axis, axis, indexing="ij")
        knots = camera.undistort(np.column_stack([u.ravel(), v.ravel()]) + corner).reshape(6, 6, 2)
        return cls(corner, axis, knots, appearance.supersampling) if np.isfinite(knots).all() else None

    def cover(self, ball: Array, radius: float) -> tuple[Array, Array]:
        """Directions (n, n, 3) of the points, and how much of each (n, n) a bead covers: part of it at the bead's border."""
        rays = np.concatenate([self._rays, np.ones((*self._rays.shape[:2], 1))], axis=-1)
        gap = np.linalg.norm(np.cross(rays, ball), axis=-1) / np.linalg.norm(rays, axis=-1)
        # From one point to the next the gap grows by this, at the middle of the bead excepted.
        slope = np.median(np.hypot(*np.gradient(gap)))
        return rays, np.clip(0.5 + (radius - gap) / slope, 0, 1)

    def inside(self, size: tuple[int, int]) -> NDArray[np.bool_]:
        """Which pixels (width, width) of the square, v first, are in an image of this size."""
        u, v = ((self.corner[i] + np.arange(self.width)) for i in (0, 1))
        return np.asarray(((v >= 0) & (v < size[1]))[:, None] & ((u >= 0) & (u < size[0])))

    def blend(self, picture: Grey, grey: Array, cover: Array) -> None:
        """Cover each pixel by a part `cover` (width, width) that adds `grey` (width, width)."""
        (u, v), (height, width) = self.corner, picture.shape
        own = np.s_[max(-v, 0) : height - v, max(-u, 0) : width - u]
        its = picture[max(v, 0) : v + self.width, max(u, 0) : u + self.width]
        its[:] = its * (1 - cover[own]) + grey[own]
