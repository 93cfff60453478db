"""Dense fields: thousands of points as the means of neighbours.

What a body does varies over its elements, and neighbours share all that is not noise: the mean displacement of a group tells
as much as its members do, with their noise divided by the root of their number. Costs then do not grow with the points.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.measurement.contents import AXES
from bcid.measurement.measurement import Measurement
from bcid.scene import Scene
from bcid.scene.parts import Vector

Array = NDArray[np.float64]
# So many fiducials are taken one by one; more are halved until there are at most so many groups.
MOST = 128


def pooled(scene: Scene, measurement: Measurement, most: int = MOST) -> tuple[Scene, Measurement]:
    """Both with the means of neighbours at rest as fiducials, where more than `most` were seen; else as they are.

    A prediction of a group is the mean of those of its members. One that is seen in part, at least by half, has the displacement of
    those that are. Stated noises are taken for independent; where neighbours share theirs the residual tells.
    """
    once = np.flatnonzero(np.isfinite(measurement.positions).any(axis=(0, 2)))
    if len(once) <= most:
        return scene, measurement
    names = [measurement.fiducial_names[k] for k in once]
    rest = np.array([scene.fiducials[name] for name in names], dtype=float)
    groups = {_name(names, group): group for group in halved_groups(rest, most)}
    members = {name: tuple(_vector(place) for place in rest[group]) for name, group in groups.items()}
    centres = np.array([rest[group].mean(axis=0) for group in groups.values()])
    moved = measurement.positions[:, once] - rest
    sums, counts = _sums(moved, groups.values())
    enough = 2 * counts >= np.array([len(group) for group in groups.values()])[:, None]
    counts = np.where(enough, counts, np.nan)
    data = measurement.data.drop_dims("fiducial").assign_coords(fiducial=list(groups), axis=AXES)
    dims = "frame", "fiducial", "axis"
    data["position"] = (dims, centres + sums / counts)
    sigma = measurement.sigma(scene.noise_sigma)
    if sigma is not None:
        squares, _ = _sums(np.where(np.isfinite(moved), sigma[:, once] ** 2, np.nan), groups.values())
        data["sigma"] = (dims, np.sqrt(squares) / counts)
    fiducials = {name: _vector(centre) for name, centre in zip(groups, centres, strict=True)}
    return replace(scene, fiducials=fiducials, members=members), replace(measurement, data=data).validated()


def halved_groups(points: Array, most: int) -> list[NDArray[np.int64]]:
    """Numbers of points (n, 3) in groups of neighbours, which are halved across their extents while they are at most so many."""
    groups: list[NDArray[np.int64]] = [np.arange(len(points))]
    while 2 * len(groups) <= most:
        groups = [half for group in groups for half in _halves(points, group)]
    return groups


def _halves(points: Array, group: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    axis = int(np.ptp(points[group], axis=0).argmax())
    order = group[np.argsort(points[group, axis], kind="stable")]
    return [np.sort(order[: len(order) // 2]), np.sort(order[len(order) // 2 :])]


def _vector(values: Array) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


def _name(names: list[str], group: NDArray[np.int64]) -> str:
    """The first member, and how many others there are: "17+38"."""
    return names[group[0]] + (f"+{len(group) - 1}" if len(group) > 1 else "")


def _sums(values: Array, groups: Iterable[NDArray[np.int64]]) -> tuple[Array, Array]:
    """Sums of what is finite of values (frames, points, 3), by group, and how many those are, each (frames, groups, 3)."""
    parts = [values[:, group] for group in groups]
    found = [np.nansum(part, axis=1) for part in parts], [np.isfinite(part).sum(axis=1) for part in parts]
    return np.stack(found[0], axis=1), np.stack(found[1], axis=1)
