"""Vectors (..., 3): products, directions, and distances of segments."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def dot(a: Array, b: Array) -> Array:
    """Scalar products (...)."""
    return np.asarray(np.sum(a * b, axis=-1))


def unit(vectors: Any) -> Array:
    """Vectors (..., 3) of length one; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1.0))


def frame_along(axis: Array) -> Array:
    """A rotation matrix whose third row is along `axis` (3,); any if that is zero."""
    along = unit(axis) if np.linalg.norm(axis) > 0 else np.array([0.0, 0.0, 1.0])
    across = unit(np.cross(np.eye(3)[int(np.argmin(np.abs(along)))], along))
    return np.array([across, np.cross(along, across), along])


def segment_gaps(aims: Array, starts: Array, ends: Array) -> Array:
    """Distances (...) between segments from the origin to `aims` (..., 3) and segments from `starts` to `ends`.

    Ericson, Real-Time Collision Detection, section 5.1.9.
    """
    axis = ends - starts
    a, e, b = dot(aims, aims), dot(axis, axis), dot(aims, axis)
    c, f = -dot(aims, starts), -dot(axis, starts)
    parallel = a * e - b * b
    s = np.clip((b * f - c * e) / np.where(parallel > 0, parallel, 1.0), 0, 1) * (parallel > 0)
    t = np.clip((b * s + f) / np.where(e > 0, e, 1.0), 0, 1)
    s = np.clip((b * t - c) / a, 0, 1)
    return np.asarray(np.linalg.norm(s[..., None] * aims - starts - t[..., None] * axis, axis=-1))
