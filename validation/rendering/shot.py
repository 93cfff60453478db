"""What stands before the cameras in one frame: a body with beads on it, the box that holds it, instruments. Body frame, m."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems
from bcid.scene.rotation import as_rotation, rotate
from validation.rendering.vectors import unit

Array = NDArray[np.float64]
# A point (3,) and the normal (3,).
Plane = tuple[Array, Array]


class Gripper(NamedTuple):
    """A box that holds the body, moved as a `Measurement` says.

    Attributes:
        translation: shape (3,), m.
        rotation: unit quaternion (w, x, y, z).
        lower, upper: corners of the box at rest, body frame, m.
        centre: about which it turns, shape (3,), m; None is the middle of the box.
    """

    translation: Array
    rotation: Array
    lower: Array
    upper: Array
    centre: Array | None = None

    def place(self, points: Array) -> Array:
        """Where points (n, 3) of the box at rest are now, m."""
        centre = (self.lower + self.upper) / 2 if self.centre is None else self.centre
        return np.asarray(rotate(self.rotation, points - centre) + centre + self.translation)

    def at_rest(self, points: Array) -> Array:
        """Where points (n, 3) that move with the box would be if it had not moved, m."""
        centre = self.place(np.zeros((1, 3)))[0]
        return np.asarray(as_rotation(self.rotation).apply(points - centre, inverse=True))


class Rod(NamedTuple):
    """An instrument: a cylinder with round ends, whose axis goes from `start` to `end` (each (3,), body frame, m)."""

    start: Array
    end: Array
    radius: float


@dataclass(frozen=True)
class Shot:
    """What is in front of the cameras in one frame; make it with `Shot.of`.

    Attributes:
        points, triangles: the body's surface, shapes (n, 3) and (m, 3).
        beads, normals: centres of the beads, and outward unit normals of the surface there, shapes (k, 3).
        gripper, rods: what else is there.
    """

    points: Array
    triangles: NDArray[np.int64]
    beads: Array
    normals: Array
    gripper: Gripper | None
    rods: list[Rod]

    @classmethod
    def of(
        cls,
        points: Array,
        triangles: NDArray[np.int64],
        beads: Array,
        normals: Array,
        gripper: Gripper | None,
        rods: Sequence[Rod],
    ) -> Shot:
        """A shot that is checked, with normals of length one.

        Raises:
            InputError: with everything that is wrong.
        """
        problems = Problems("frame to be drawn")
        nodes, centres, outward = (
            _rows(value, name, problems) for value, name in ((points, "points"), (beads, "beads"), (normals, "normals"))
        )
        faces = _faces(triangles, len(nodes), problems)
        if len(outward) != len(centres):
            problems.add("normals", f"{len(outward)} for {len(centres)} beads; one per bead is needed")
        elif not (np.linalg.norm(outward, axis=1) > 0).all():
            problems.add("normals", "one of them is zero")
        box = None if gripper is None else _gripper(gripper, problems)
        bars = [_rod(rod, i, problems) for i, rod in enumerate(rods)]
        problems.raise_if_any()
        return cls(nodes, faces, centres, unit(outward), box, bars)

    def floor(self, below: float) -> Plane:
        """A plane so far below the body, m, across the mean normal of the beads."""
        mean = self.normals.mean(axis=0)
        normal = unit(mean if np.linalg.norm(mean) > 1e-3 else self.normals[0])
        height = float((self.points @ normal).min()) - below
        middle = self.points.mean(axis=0)
        return middle + (height - middle @ normal) * normal, normal


def _rows(value: Any, name: str, problems: Problems) -> Array:
    array = np.asarray(value, dtype=float)
    if array.ndim != 2 or array.shape[1:] != (3,) or len(array) == 0:
        problems.add(name, f"expected an array of shape (n, 3) with n > 0, found shape {array.shape}")
        return np.ones((1, 3))
    if not np.isfinite(array).all():
        bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
        problems.add(name, f"{len(bad)} of {len(array)} rows are not finite, the first is row {bad[0]}")
    return array


def _faces(value: Any, count: int, problems: Problems) -> NDArray[np.int64]:
    faces = np.asarray(value)
    if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) == 0 or faces.dtype.kind not in "iu":
        problems.add("triangles", f"expected integers of shape (m, 3), found {faces.dtype} of shape {faces.shape}")
        return np.zeros((1, 3), dtype=np.int64)
    if faces.min() < 0 or faces.max() >= count:
        problems.add("triangles", f"nodes {faces.min()} to {faces.max()}, but there are points 0 to {count - 1} only")
    return faces.astype(np.int64)


def _gripper(given: Gripper, problems: Problems) -> Gripper | None:
    parts: list[Any] = [None if part is None else np.asarray(part, dtype=float) for part in given]
    shapes = [(3,), (4,), (3,), (3,), (3,)]
    if any(p is not None and (p.shape != s or not np.isfinite(p).all()) for p, s in zip(parts, shapes, strict=True)):
        problems.add("gripper", "expected finite translation (3), rotation (4), lower, upper (3), centre (3) or None")
        return None
    gripper = Gripper(*parts)
    if abs(np.linalg.norm(gripper.rotation) - 1) > 1e-3:
        problems.add("gripper", f"its rotation {gripper.rotation} is not a unit quaternion (w, x, y, z)")
    if not (gripper.lower < gripper.upper).all():
        problems.add("gripper", f"its box ends at {gripper.upper} before it begins at {gripper.lower}")
    return gripper._replace(rotation=gripper.rotation / (np.linalg.norm(gripper.rotation) or 1.0))


def _rod(rod: Rod, number: int, problems: Problems) -> Rod:
    start, end, radius = np.asarray(rod.start, dtype=float), np.asarray(rod.end, dtype=float), float(rod.radius)
    ends = start.shape == end.shape == (3,) and bool(np.isfinite(start).all() and np.isfinite(end).all())
    if not ends or not 0 < radius < math.inf:
        problems.add("rods", f"rod {number}: expected two finite ends (3) and a positive radius, found {tuple(rod)}")
    return Rod(start, end, radius)
