"""Which facets of a boundary lie in a box, on a plane, in a sphere, or look in a direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.scene import Box, Facing, Plane, Region, Sphere

Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]

ENLARGE = "enlarge what chooses it, or use a finer mesh"


def wholly_in(corners: Array, box: Box, tolerance: float) -> Chosen:
    """Which entities (k, corners, 3) have all corners in a box."""
    low, high = np.array(box.lower) - tolerance, np.array(box.upper) + tolerance
    return np.asarray(((corners >= low) & (corners <= high)).all(axis=(1, 2)))


def on_plane(corners: Array, plane: Plane, tolerance: float) -> Chosen:
    """Which entities (k, corners, 3) have all corners on a plane."""
    distance = (corners - np.array(plane.point)) @ np.array(plane.normal)
    return np.asarray((np.abs(distance) <= tolerance).all(axis=1))


def in_piece(middle: Array, box: Box, tolerance: float) -> Chosen:
    """Which middles (k, 3) belong to one of the boxes that tile the space."""
    # Both bounds are moved alike, so that neighbours still meet: a middle on the cut belongs to the upper one
    # whatever its round-off.
    low, high = np.array(box.lower) - tolerance, np.array(box.upper) - tolerance
    return np.asarray(((middle >= low) & (middle < high)).all(axis=1))


def in_sphere(middle: Array, sphere: Sphere, tolerance: float) -> Chosen:
    """Which middles (k, 3) lie in a sphere."""
    return np.asarray(np.linalg.norm(middle - np.array(sphere.centre), axis=1) <= sphere.radius + tolerance)


def looking(corners: Array, facing: Facing) -> Chosen:
    """Which triangles (k, 3, 3), against the clock as seen from outside, look in a direction, to within its angle."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cosine = normal @ np.array(facing.normal) / np.linalg.norm(normal, axis=1)
    return np.asarray(cosine >= np.cos(np.radians(facing.within)) - 1e-9)


def missed(region: Region) -> str:
    """What no facet does, as the end of a sentence."""
    words = [
        (region.box or region.plane, "lies wholly in the box or on the plane"),
        (region.sphere, "has its middle in the sphere"),
        (region.facing, "looks in the direction of the normal, to within the angle"),
        (region.painted, "is painted with the value"),
    ]
    return " and ".join(text for criterion, text in words if criterion) or "is in the group"
