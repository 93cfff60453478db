"""Images of beads drawn as discs, a pulled sheet that carries them, and two cameras: all in closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.vision.camera import Camera, Cameras

Array = NDArray[np.float64]
LAYOUT = {
    str(i + 1): (x * 1e-3, 0.01, z * 1e-3)
    for i, (x, z) in enumerate((x, z) for z in (12.5, 37.5, 62.5, 87.5) for x in (15, 35, 55, 75))
}
REST = np.array(list(LAYOUT.values()))
DIAMETER = 1e-3
_FINE = 4


def cameras(distortion: tuple[float, ...] = (-0.12, 0.05, 0.0, 0.0)) -> Cameras:
    """Two cameras of 1280 x 1024 px, 0.3 m from what they look at, 30 degrees apart."""
    angle = np.radians(30)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    lens = np.array(distortion)
    left = Camera(np.array([[2260.0, 0, 641.3], [0, 2255.0, 508.7], [0, 0, 1]]), lens, (1280, 1024))
    right = Camera(np.array([[2248.0, 0, 633.1], [0, 2251.0, 517.2], [0, 0, 1]]), lens, (1280, 1024))
    target = np.array([0.0, 0.0, 0.3])
    return Cameras(left, right, turn, target - turn @ target)


# The body in the left camera's frame: seen from above, x to the right and z downwards, in the middle of the picture.
TO_CAMERA = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
SHIFT = np.array([-0.05, -0.05, 0.3 + 0.01])


def in_camera(points: Array) -> Array:
    """Points (n, 3) of the body's frame in the left camera's, m."""
    return np.asarray(points @ TO_CAMERA.T + SHIFT)


def pulled(points: Array, amount: float) -> Array:
    """Places (n, 3), m, of points when the edge x = 0.1 m has moved by `amount` m: stretched, lifted, and drawn to one side."""
    x = points[:, 0] / 0.1
    moved = points.copy()
    moved[:, 0] += amount * x**1.5
    moved[:, 1] += 0.3 * amount * x**2
    moved[:, 2] += 0.2 * amount * x * (points[:, 2] / 0.1 - 0.5)
    return moved


def draw(
    pixels: Array,
    diameter: float,
    rng: np.random.Generator,
    size: tuple[int, int] = (1280, 1024),
    noise: float = 2.0,
    hidden: NDArray[np.bool_] | None = None,
) -> NDArray[np.uint8]:
    """Image (height, width) with dark discs at pixels (n, 2) on a ground that grows brighter to the right."""
    import cv2

    width, height = size
    image = np.broadcast_to(np.linspace(150, 220, width), (height, width)).copy()
    reach = int(np.ceil(diameter))
    fine = (np.arange((2 * reach + 1) * _FINE) + 0.5) / _FINE - 0.5
    for number, (u, v) in enumerate(pixels):
        if not np.isfinite([u, v]).all() or (hidden is not None and hidden[number]):
            continue
        column, row = int(u) - reach, int(v) - reach
        if not (0 <= column < width - 2 * reach - 1 and 0 <= row < height - 2 * reach - 1):
            continue
        x, y = np.meshgrid(fine + column, fine + row)
        inside = ((x - u) ** 2 + (y - v) ** 2 < diameter**2 / 4).astype(float)
        share = inside.reshape(2 * reach + 1, _FINE, 2 * reach + 1, _FINE).mean(axis=(1, 3))
        part = image[row : row + 2 * reach + 1, column : column + 2 * reach + 1]
        part += share * (45 - part)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    return np.clip(np.round(image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)
