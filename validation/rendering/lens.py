"""The lens of a rendering camera: what VTK draws as a pinhole picture is bent to the camera's image."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.vision.camera import Camera
from bcid.vision.images import Image

Array = NDArray[np.float64]

# Points that VTK draws across a pixel; jagged edges of the body would otherwise show through the blur.
_DRAWN = 2
# Pixels between the points at which a lens is undone; splines give the rest to 1e-6 px.
_KNOTS = 8.0
# Largest picture VTK can be trusted with, px.
_LARGEST = 16384


class Lens:
    """Where the pixels of a camera look, and the pinhole picture they need.

    Args:
        side: name of the camera.
        camera: must state the size of its images.

    Attributes:
        rays: directions of all pixels, x/z and y/z, shape (height, width, 2).
        window: width and height of the pinhole picture, px.
        middle, half: what it covers, in directions: its middle, and half of its width and height.

    Raises:
        InputError: no size, or a distortion that cannot be undone inside the image.
    """

    def __init__(self, side: str, camera: Camera) -> None:
        width, height = camera.size
        if width <= 0 or height <= 0:
            raise InputError(f"the {side} camera has images of {width} x {height} px: state the size of its images")
        self.camera = camera
        self.rays = self._all_rays(side)
        low, high = self.rays.reshape(-1, 2).min(axis=0), self.rays.reshape(-1, 2).max(axis=0)
        self.middle = (low + high) / 2
        self._step = 1 / (_DRAWN * max(camera.matrix[0, 0], camera.matrix[1, 1]))
        # A margin, so that what is averaged for the outermost pixels is all there.
        width, height = (int(n) for n in np.ceil((high - low) / self._step) + 4 * _DRAWN)
        if max(width, height) > _LARGEST:
            raise InputError(f"the {side} camera: a picture of {width} x {height} points is too large to be drawn")
        self.widen((width, height))

    def widen(self, window: tuple[int, int]) -> None:
        """Make the pinhole picture larger, as when it is drawn for another camera too."""
        import cv2

        self.window, self.half = window, np.array(window) * self._step / 2
        # The first pixel begins at the border of the window: its middle is half a step inside.
        places = ((self.rays - self.middle + self.half) / self._step - 0.5).astype(np.float32)
        # Whole numbers with 1/32 of a point: OpenCV is several times faster with them.
        self._map = cv2.convertMaps(places, None, cv2.CV_16SC2)

    def bent(self, drawn: Image) -> Image:
        """The camera's image of what is in a pinhole picture, with the same channels."""
        import cv2

        return np.asarray(cv2.remap(_averaged(drawn), *self._map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _all_rays(self, side: str) -> Array:
        """Directions (height, width, 2), x/z and y/z, of all pixels."""
        from scipy.interpolate import RectBivariateSpline

        axes = [np.linspace(0, max(n - 1, 1), max(4, math.ceil(n / _KNOTS) + 1)) for n in self.camera.size]
        u, v = np.meshgrid(*axes, indexing="ij")
        knots = self.camera.undistort(np.column_stack([u.ravel(), v.ravel()])).reshape(*u.shape, 2)
        if not np.isfinite(knots).all():
            raise InputError(f"the {side} camera: its distortion cannot be undone inside its image; calibrate it again")
        pixels = [np.arange(n) for n in self.camera.size]
        return np.stack([RectBivariateSpline(*axes, knots[..., i])(*pixels).T for i in (0, 1)], axis=-1)


def _averaged(drawn: Image) -> Image:
    """Mean over the width of a pixel of the camera around every point of the pinhole picture.

    Symmetric for every number of points per pixel: a border that is cut by the pixel's counts for the part inside.
    """
    import cv2

    offsets = np.arange(-(_DRAWN // 2), _DRAWN // 2 + 1)
    kernel = np.clip(_DRAWN / 2 - np.abs(offsets) + 0.5, 0, 1) / _DRAWN
    return np.asarray(cv2.sepFilter2D(drawn, cv2.CV_8U, kernel, kernel, borderType=cv2.BORDER_REPLICATE))
