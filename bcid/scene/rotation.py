"""Rotations as unit quaternions (w, x, y, z), as actions and files hold them; the algebra is SciPy's."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def as_rotation(quaternion: ArrayLike) -> Rotation:
    """SciPy's rotation of one quaternion, shape (4,), or of several, shape (n, 4)."""
    return Rotation.from_quat(quaternion, scalar_first=True)


def as_quaternion(rotation: Rotation) -> Array:
    """The quaternion of a rotation, shape (4,), or of several, shape (n, 4)."""
    return np.asarray(rotation.as_quat(scalar_first=True))


def from_vector(degrees: ArrayLike) -> Array:
    """Quaternion of the turn about the direction of a vector by its length in degrees."""
    return as_quaternion(Rotation.from_rotvec(degrees, degrees=True))


def rotate(quaternion: ArrayLike, points: ArrayLike) -> Array:
    """Points, shape (..., 3), turned by a quaternion."""
    points = np.asarray(points, dtype=float)
    return np.asarray(as_rotation(quaternion).apply(points.reshape(-1, 3)).reshape(points.shape))


def conjugated(turn: ArrayLike, quaternions: ArrayLike) -> Array:
    """The rotations, shape (n, 4), as seen in axes that are turned: turn q turn^-1."""
    turned = as_rotation(turn)
    return as_quaternion(turned * as_rotation(quaternions) * turned.inv())


def slerp(a: ArrayLike, b: ArrayLike, fraction: ArrayLike) -> Array:
    """Quaternions between two, along the shortest arc; beyond them for a fraction outside of 0 to 1.

    Two of shape (4,) and a number, or shapes that go together: (n, 4), (n, 4) and (n,).
    """
    start = as_rotation(a)
    arc = (start.inv() * as_rotation(b)).as_rotvec()
    return as_quaternion(start * Rotation.from_rotvec(np.asarray(fraction)[..., None] * arc))
