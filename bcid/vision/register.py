"""The frame of the cameras and the frame of the body: which bead is which, and the rigid motion between the two.

The motion takes a point x in the left camera's frame to scale R x + t in the body's. It is fitted to the beads at rest with
weights from their covariances (start: Kabsch, Acta Cryst. A 32, 1976; Umeyama, IEEE PAMI 13, 1991); the inverse of the normal
matrix is its covariance. An error of it is common to all points and steps: it is kept as such, and is no part of their noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.frame_error import FrameError, slopes
from bcid.vision.triangulate import Points

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_STEPS, _EXACT = 50, 1e-14
# Triples of beads that an assignment is built on: large ones first, then any, for beads that are seen may stand close together. The
# part of the beads that must be found to stop looking, after each large one and after each other one.
_LARGE, _ANY = 12, 60
_ENOUGH, _HALF = 0.9, 0.5
# Another assignment is as good when it finds this part of the beads and its distances are at most so many times as large.
_AS_MANY, _AS_GOOD = 0.8, 2.0
# Hypotheses looked at together.
_BATCH = 2000


@dataclass(frozen=True)
class Registration:
    """From the left camera's frame to the body's.

    Attributes:
        rotation, translation, scale: body = scale rotation camera + translation; shapes (3, 3), (3,) m.
        error: what is not known of it, about the middle of the beads, in the body's frame; none of a scale that is fixed.
        rms: of the beads at rest against the layout, m.
        residuals: of each bead, shape (beads, 3), m, in the body's frame; NaN where one was not seen.
        free_scale: the scale when it is fitted too, and its standard deviation.
    """

    rotation: Array
    translation: Array
    scale: float
    error: FrameError
    rms: float
    residuals: Array
    free_scale: tuple[float, float]

    def to_body(self, points: Array) -> Array:
        """Points (..., 3), m, of the camera's frame in the body's."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def to_camera(self, points: Array) -> Array:
        """The inverse of `to_body`."""
        return np.asarray((points - self.translation) @ self.rotation / self.scale)

    def vectors_to_camera(self, vectors: Array) -> Array:
        """Displacements (..., 3), m, of the body's frame in the camera's."""
        return np.asarray(vectors @ self.rotation / self.scale)

    def turned(self, covariance: Array) -> Array:
        """Covariances (..., 3, 3), m^2, of points in the camera's frame, in the body's."""
        return np.asarray(self.scale**2 * self.rotation @ covariance @ self.rotation.T)


def register(points: Points, layout: Array, layout_sigma: float = 0.0, scale: bool = False) -> Registration:
    """Fit the motion to beads at rest.

    Args:
        points: in the camera's frame, in the order of the layout; NaN for beads that were not seen.
        layout: rest positions in the body's frame, shape (beads, 3), m.
        layout_sigma: standard deviation of a coordinate of it, m. Where what is left is larger than all that, the covariance is
            scaled up to it.
        scale: whether to fit a scale as well.
    """
    seen = np.isfinite(points.positions).all(axis=1)
    camera, body, spread = points.positions[seen], layout[seen], points.covariance[seen]
    fixed = _fit(camera, body, spread, layout_sigma, False)
    free = _fit(camera, body, spread, layout_sigma, True)
    rotation, translation, factor, covariance = free if scale else fixed
    residuals = np.full(layout.shape, np.nan)
    residuals[seen] = factor * camera @ rotation.T + translation - body
    return Registration(
        rotation,
        translation,
        factor,
        FrameError(body.mean(axis=0), covariance),
        float(np.sqrt(np.mean(residuals[seen] ** 2))),
        residuals,
        (free[2], float(free[2] * np.sqrt(free[3][6, 6]))),
    )


def _fit(camera: Array, body: Array, spread: Array, sigma: float, scale: bool) -> tuple[Array, Array, float, Array]:
    """Rotation, translation, scale, covariance (7, 7) about the middle of the beads in the body's frame."""
    from scipy.spatial.transform import Rotation

    rotation, translation, factor = rigid(camera, body, scale)
    middle = body.mean(axis=0)
    count = 7 if scale else 6
    for _ in range(_STEPS):
        moved = factor * camera @ rotation.T + translation
        weight = np.linalg.inv(factor**2 * rotation @ spread @ rotation.T + (sigma**2 + 1e-18) * np.eye(3))
        slope = slopes(moved - middle)[:, :, :count]
        normal = np.einsum("nji,njk,nkl->il", slope, weight, slope)
        left = body - moved
        step = np.linalg.solve(normal, np.einsum("nji,njk,nk->i", slope, weight, left))
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        grow = np.exp(step[6]) if scale else 1.0
        rotation, factor = turn @ rotation, float(factor * grow)
        translation = grow * turn @ (translation - middle) + middle + step[3:6]
        if np.abs(step).max() < _EXACT:
            break
    left = body - (factor * camera @ rotation.T + translation)
    freedom = max(3 * len(body) - count, 1)
    excess = float(np.einsum("ni,nij,nj->", left, weight, left)) / freedom
    covariance = np.zeros((7, 7))
    covariance[:count, :count] = np.linalg.inv(normal) * max(excess, 1.0)
    return rotation, translation, factor, covariance


def rigid(source: Array, target: Array, scale: bool = False) -> tuple[Array, Array, float]:
    """Rotation (..., 3, 3), translation (..., 3) and scale that take points (..., n, 3) closest to others, all alike weighted."""
    first, second = source.mean(axis=-2, keepdims=True), target.mean(axis=-2, keepdims=True)
    u, sizes, v = np.linalg.svd(np.swapaxes(target - second, -1, -2) @ (source - first))
    sign = np.ones(sizes.shape)
    sign[..., 2] = np.sign(np.linalg.det(u @ v))
    rotation = (u * sign[..., None, :]) @ v
    factor = 1.0
    if scale:
        factor = float(np.sum(sizes * sign) / np.sum((source - first) ** 2))
    translation = (second - factor * first @ np.swapaxes(rotation, -1, -2))[..., 0, :]
    return rotation, translation, factor


@dataclass(frozen=True)
class Assignment:
    """Which of some points is which bead.

    Attributes:
        points: number of the point of each bead, shape (beads,); -1 where none is near.
        rms: distance from the layout, m.
    """

    points: Indices
    rms: float

    @property
    def count(self) -> int:
        """How many beads have a point."""
        return int(np.sum(self.points >= 0))


def find(
    points: Array, layout: Array, tolerance: float, hints: Mapping[int, Indices] | None = None
) -> list[Assignment]:
    """Ways to lay a layout (n, 3) onto some of the points (m, 3) by a rigid motion, as good as the best; m.

    Every triple of points with the distances of a triple of beads is tried. More than one way is found where a layout is
    symmetric.

    Args:
        tolerance: a bead's point is at most so far from its place, m.
        hints: points that a bead may be, by the number of the bead; at least one of these beads must have such a point, none
            another, and no other bead one of these.
    """
    found: dict[tuple[int, ...], Assignment] = {}
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    for number, triple in enumerate(_triples(layout)):
        corners = _alike(apart, layout[list(triple)], tolerance)
        for begin in range(0, len(corners), _BATCH):
            for one in _laid(points, layout, triple, corners[begin : begin + _BATCH], tolerance):
                if _fits(one, hints or {}):
                    found[tuple(one.points)] = one
        most = max((one.count for one in found.values()), default=0)
        if most >= (_ENOUGH if number < _LARGE - 1 else _HALF) * len(layout):
            break
    ranked = sorted(found.values(), key=lambda one: (-one.count, one.rms))
    if not ranked:
        return []
    best = ranked[0]
    allowance = max(_AS_GOOD * best.rms, best.rms + tolerance / 20)
    rivals = [one for one in ranked[1:] if one.count >= _AS_MANY * best.count and one.rms <= allowance]
    # Assignments that differ in a bead or two are variants of one way, not others.
    ways = [best]
    for one in rivals:
        if all(np.mean((one.points == way.points)[one.points >= 0]) < 0.5 for way in ways):
            ways.append(one)
    return ways


def _fits(assignment: Assignment, hints: Mapping[int, Indices]) -> bool:
    """Whether a bead with a hint is found at its point, and none of these points is another bead's."""
    if not hints:
        return True
    of_point = {int(point): bead for bead, points in hints.items() for point in points}
    assigned = {bead: int(point) for bead, point in enumerate(assignment.points) if point >= 0}
    told = {bead: of_point[point] for bead, point in assigned.items() if point in of_point}
    return (
        bool(told)
        and all(bead == named for bead, named in told.items())
        and not (hints.keys() & assigned.keys()) - told.keys()
    )


def _triples(layout: Array) -> list[tuple[int, int, int]]:
    """Triples of beads: the largest triangles, no bead in more than a few of them, and then any that are no lines."""
    count = len(layout)
    rng = np.random.default_rng(0)
    numbers = np.array([rng.choice(count, 3, replace=False) for _ in range(400)])
    a, b, c = (layout[numbers[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen: list[tuple[int, int, int]] = []
    used = np.zeros(count, dtype=int)
    for number in numbers[np.argsort(-area)]:
        if len(chosen) < _LARGE and used[number].max() < max(3 * _LARGE // count, 2):
            used[number] += 1
            chosen.append((int(number[0]), int(number[1]), int(number[2])))
    others = numbers[area > 0.05 * area.max()][:_ANY]
    return chosen + [(int(i), int(j), int(k)) for i, j, k in others]


def _alike(apart: Array, corners: Array, tolerance: float) -> Indices:
    """Triples of points (k, 3) whose distances are those of three corners (3, 3)."""
    sides = [np.linalg.norm(corners[i] - corners[j]) for i, j in ((0, 1), (0, 2), (1, 2))]
    first, second, third = (np.abs(apart - side) < 2 * tolerance for side in sides)
    result = []
    for i, j in np.argwhere(first):
        if i != j:
            result += [(i, j, k) for k in np.flatnonzero(second[i] & third[j]) if k not in (i, j)]
    return np.array(result, dtype=np.int64).reshape(-1, 3)


def _laid(
    points: Array, layout: Array, triple: tuple[int, int, int], corners: Indices, tolerance: float
) -> list[Assignment]:
    """The best assignments that follow from laying three beads onto triples of points (k, 3)."""
    if len(corners) == 0:
        return []
    rotation, translation, _ = rigid(np.broadcast_to(layout[list(triple)], (len(corners), 3, 3)), points[corners])
    placed = layout @ np.swapaxes(rotation, 1, 2) + translation[:, None]
    distance = np.linalg.norm(placed[:, :, None] - points[None, None], axis=3)
    counts = np.sum(distance.min(axis=2) < 2 * tolerance, axis=1)
    best = np.flatnonzero(counts >= max(counts.max() - 1, 4))
    return [one for i in best[:50] if (one := _settled(points, layout, distance[i], tolerance)) is not None]


def _settled(points: Array, layout: Array, distance: Array, tolerance: float) -> Assignment | None:
    """Points of the beads after the motion is fitted to all of them; None when fewer than four are left."""
    from scipy.optimize import linear_sum_assignment

    for reach in (2 * tolerance, tolerance):
        beads, numbers = linear_sum_assignment(np.minimum(distance, reach))
        near = distance[beads, numbers] < reach
        beads, numbers = beads[near], numbers[near]
        if len(beads) < 4:
            return None
        rotation, translation, _ = rigid(layout[beads], points[numbers])
        distance = np.linalg.norm((layout @ rotation.T + translation)[:, None] - points[None], axis=2)
    near = distance[beads, numbers] < tolerance
    assigned = np.full(len(layout), -1, dtype=np.int64)
    assigned[beads[near]] = numbers[near]
    if near.sum() < 4:
        return None
    return Assignment(assigned, float(np.sqrt(np.mean(distance[beads[near], numbers[near]] ** 2))))
