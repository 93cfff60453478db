"""Rotations as unit quaternions (w, x, y, z)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def from_vector(degrees: ArrayLike) -> Array:
    """Rotation about the direction of a vector by its length in degrees."""
    vector = np.radians(np.asarray(degrees, dtype=float))
    half = np.linalg.norm(vector) / 2
    # sinc keeps the direction's digits at a small angle, where vector / angle would lose them.
    return np.concatenate([[np.cos(half)], vector / 2 * np.sinc(half / np.pi)])


def product(a: Array, b: Array) -> Array:
    """The rotation b followed by a."""
    scalar = a[0] * b[0] - a[1:] @ b[1:]
    return np.concatenate([[scalar], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])


def inverse(a: Array) -> Array:
    """The rotation back."""
    return a * np.array([1.0, -1.0, -1.0, -1.0])


def slerp(a: Array, b: Array, fraction: float) -> Array:
    """Rotation between two, along the shortest arc."""
    cosine = float(a @ b)
    if cosine < 0:
        b, cosine = -b, -cosine
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-9:
        mixed = (1 - fraction) * a + fraction * b
    else:
        mixed = (np.sin((1 - fraction) * angle) * a + np.sin(fraction * angle) * b) / np.sin(angle)
    return np.asarray(mixed / np.linalg.norm(mixed))
