"""Which of some points are the beads of a layout: every rigid motion that lays the layout onto them is looked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.vision.register import rigid

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# So many beads are needed to lay a layout onto points.
LEAST = 4
# Points whose spread along an axis is less than this part of the largest stand in a plane, or in a row.
_FLAT = 0.02
# Triples of beads that an assignment is built on: large ones first, then any, for beads that are seen may stand close together. The
# part of the beads that must be found to stop looking, after each large one and after each other one.
_LARGE, _ANY = 12, 60
_ENOUGH, _HALF = 0.9, 0.5
# Another assignment is as good when it finds this part of the beads and its distances are at most so many times as large.
_AS_MANY, _AS_GOOD = 0.8, 2.0
# Hypotheses looked at together.
_BATCH = 2000

# Smoothing of the spline: none but what rounding asks for.
_SMOOTH = 1e-6


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


def axes(points: Array) -> Array:
    """Directions (k, 3) along which points (n, 3) spread: three for a body, two for a plane, one for a row."""
    sizes, directions = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[1:]
    return np.asarray(directions[sizes > _FLAT * sizes[0]])


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
    best = np.flatnonzero(counts >= max(counts.max() - 1, LEAST))
    return [one for i in best[:50] if (one := _settled(points, layout, distance[i], tolerance)) is not None]


def _settled(points: Array, layout: Array, distance: Array, tolerance: float) -> Assignment | None:
    """Points of the beads after the motion is fitted to all of them; None when those that are left tell no motion."""
    from scipy.optimize import linear_sum_assignment

    for reach in (2 * tolerance, tolerance):
        beads, numbers = linear_sum_assignment(np.minimum(distance, reach))
        near = distance[beads, numbers] < reach
        beads, numbers = beads[near], numbers[near]
        if not spans(layout[beads]):
            return None
        rotation, translation, _ = rigid(layout[beads], points[numbers])
        distance = np.linalg.norm((layout @ rotation.T + translation)[:, None] - points[None], axis=2)
    near = distance[beads, numbers] < tolerance
    beads, numbers = beads[near], numbers[near]
    if not spans(layout[beads]):
        return None
    assigned = np.full(len(layout), -1, dtype=np.int64)
    assigned[beads] = numbers
    return Assignment(assigned, float(np.sqrt(np.mean(distance[beads, numbers] ** 2))))


def spans(places: Array) -> bool:
    """Whether places tell a rigid motion: there are enough, and not in a row."""
    return len(places) >= LEAST and len(axes(places)) > 1


def neighbours(rest: Array, displacement: Array) -> Array:
    """What the others say of each bead's displacement, shape (beads, 3), m: a thin plate spline without the bead itself.

    Args:
        rest: places at rest, shape (beads, 3), m.
        displacement: shape (beads, 3), m; NaN where not known. With fewer than four others the result is NaN.
    """
    from scipy.interpolate import RBFInterpolator

    away = rest - rest.mean(axis=0)
    # Places in a plane or in a row have so many coordinates only.
    flat = away @ axes(rest).T / np.linalg.norm(away)
    known = np.asarray(np.isfinite(displacement).all(axis=1))
    said = np.full(displacement.shape, np.nan)
    for bead in range(len(rest)):
        others = known.copy()
        others[bead] = False
        if others.sum() >= max(LEAST, flat.shape[1] + 1):
            try:
                spline = RBFInterpolator(
                    flat[others], displacement[others], kernel="thin_plate_spline", smoothing=_SMOOTH
                )
                said[bead] = spline(flat[bead : bead + 1])[0]
            except np.linalg.LinAlgError:
                # Those that are left stand in a row.
                said[bead] = displacement[others].mean(axis=0)
    return said
