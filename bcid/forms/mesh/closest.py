"""The points of triangles that are closest to places."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

# Places that are looked at together, which bounds the memory that their candidates take.
_TOGETHER = 2000


def closest_triangles(triangles: Array, places: Array) -> tuple[Numbers, Array]:
    """The triangle closest to each place (n, 3), shape (n,), of triangles (k, 3, 3), and where on it: barycentric, (n, 3)."""
    near = Neighbourhood(triangles)
    parts = [near.closest(places[i : i + _TOGETHER]) for i in range(0, len(places), _TOGETHER)]
    number = np.concatenate([part for part, _ in parts])
    return number, _barycentric(triangles[number], np.concatenate([point for _, point in parts]))


class Neighbourhood:
    """Finds triangles (k, 3, 3) near places, whatever their sizes: classes of like size have a tree each."""

    def __init__(self, triangles: Array) -> None:
        self.triangles = triangles
        self.middle = triangles.mean(axis=1)
        self.radius = np.linalg.norm(triangles - self.middle[:, None], axis=2).max(axis=1)
        octave = np.floor(np.log2(np.maximum(self.radius, 1e-300)))
        self._classes = [np.flatnonzero(octave == one) for one in np.unique(octave)]
        self._all = cKDTree(self.middle)
        self._trees = [cKDTree(self.middle[members]) for members in self._classes]

    def pairs(self, places: Array, reach: Array) -> tuple[Numbers, Numbers]:
        """Places (n, 3) and the triangles whose bounding sphere is within reach (n,) of them, as two arrays of numbers."""
        found: list[tuple[Numbers, Numbers]] = []
        for members, tree in zip(self._classes, self._trees, strict=True):
            lists = tree.query_ball_point(places, reach + self.radius[members].max())
            place = np.repeat(np.arange(len(places)), [len(one) for one in lists])
            number = (
                members[np.concatenate([np.asarray(one, dtype=np.int64) for one in lists])] if len(place) else place
            )
            apart = np.linalg.norm(places[place] - self.middle[number], axis=1)
            kept = apart <= (reach[place] + self.radius[number]) * (1 + 1e-9)
            found.append((place[kept], number[kept]))
        return np.concatenate([one for one, _ in found]), np.concatenate([other for _, other in found])

    def closest(self, places: Array) -> tuple[Numbers, Array]:
        """Numbers of the triangles closest to places (n, 3), and the points on them, (n, 3)."""
        guess = self._all.query(places)[1]
        reach = np.linalg.norm(closest_on_triangles(self.triangles[guess], places) - places, axis=1)
        place, number = self.pairs(places, reach)
        points = closest_on_triangles(self.triangles[number], places[place])
        apart = np.linalg.norm(points - places[place], axis=1)
        order = np.lexsort((number, apart, place))
        first = order[np.unique(place[order], return_index=True)[1]]
        return number[first], points[first]


def _barycentric(triangles: Array, points: Array) -> Array:
    """Weights of the corners of triangles (n, 3, 3) at points in them (n, 3), shape (n, 3)."""
    a, b, c = (triangles[:, i] for i in range(3))
    normal = np.cross(b - a, c - a)
    squared = np.einsum("ij,ij->i", normal, normal)
    sides = [np.cross(q - p, points - p) for p, q in ((b, c), (c, a), (a, b))]
    return np.stack([np.einsum("ij,ij->i", side, normal) / squared for side in sides], axis=1)


def closest_on_triangles(triangles: Array, position: Array) -> Array:
    """Closest point of each triangle (n, 3, 3) to a position, or to one of its own (n, 3), shape (n, 3)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    options = [_closest_on_segments(p, q, position) for p, q in ((a, b), (b, c), (c, a))]
    normal = np.cross(b - a, c - a)
    squared = np.einsum("ij,ij->i", normal, normal)
    offset = np.einsum("ij,ij->i", position - a, normal) / squared
    foot = position - offset[:, None] * normal
    inside = np.ones(len(a), dtype=bool)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(q - p, foot - p), normal) >= 0
    distances = np.array([np.linalg.norm(o - position, axis=1) for o in options])
    edge = np.array(options)[distances.argmin(axis=0), np.arange(len(a))]
    return np.where(inside[:, None], foot, edge)


def _closest_on_segments(a: Array, b: Array, position: Array) -> Array:
    along = b - a
    t = np.einsum("ij,ij->i", position - a, along) / np.einsum("ij,ij->i", along, along)
    return a + np.clip(t, 0, 1)[:, None] * along
