"""Dense fields: thousands of points as the means of neighbours.

What a body does varies over its elements, and neighbours share all that is not noise: the mean displacement of a group tells
as much as its members do, with their noise divided by the root of their number. Costs then do not grow with the points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.measurement.contents import AXES
from bcid.measurement.measurement import Measurement
from bcid.scene import Scene
from bcid.scene.parts import Vector

Array = NDArray[np.float64]
# So many fiducials are taken one by one; more are halved until there are at most so many groups.
MOST = 128


@dataclass(frozen=True)
class Pooled:
    """A scene and a measurement with groups as fiducials.

    Attributes:
        groups: of each, the names of its members.
    """

    scene: Scene
    measurement: Measurement
    groups: dict[str, tuple[str, ...]]


def pooled(scene: Scene, measurement: Measurement, most: int = MOST) -> Pooled | None:
    """The means of neighbours at rest, where more fiducials than `most` were seen; else None.

    A prediction of a group is the mean of those of its members. One that is seen in part, at least by half, has the displacement of
    those that are. Stated noises are taken for independent; where neighbours share theirs the residual tells.
    """
    seen_once = np.asarray(np.isfinite(measurement.positions).any(axis=(0, 2)))
    names = [name for name, seen in zip(measurement.fiducial_names, seen_once, strict=True) if seen]
    if len(names) <= most:
        return None
    rest = np.array([scene.fiducials[name] for name in names], dtype=float)
    members = _halved(rest, most)
    groups = {_name(names, group): tuple(names[k] for k in group) for group in members}
    fiducials = {name: _vector(rest[group].mean(axis=0)) for name, group in zip(groups, members, strict=True)}
    moved = measurement.positions[:, seen_once] - rest
    counts = np.stack([np.isfinite(moved[:, group]).sum(axis=1) for group in members], axis=1)
    centres = np.array(list(fiducials.values()))
    places = {name: tuple(_vector(rest[k]) for k in group) for name, group in zip(groups, members, strict=True)}
    data = measurement.data.drop_dims("fiducial").assign_coords(fiducial=list(groups), axis=AXES)
    dims = "frame", "fiducial", "axis"
    data["position"] = (dims, centres + _mean(moved, members))
    sigma = measurement.sigma(scene.noise_sigma)
    if sigma is not None:
        seen = np.where(np.isfinite(moved), sigma[:, seen_once] ** 2, np.nan)
        data["sigma"] = (dims, np.sqrt(_mean(seen, members) / np.maximum(counts, 1)))
    whole = replace(measurement, data=_ordered(data))
    return Pooled(replace(scene, fiducials=fiducials, members=places), whole, groups)


def _halved(points: Array, most: int) -> list[NDArray[np.int64]]:
    """Groups of neighbours, by halving the largest across its longest extent until there are `most`."""
    groups: list[NDArray[np.int64]] = [np.arange(len(points))]
    while 2 * len(groups) <= most:
        groups = [half for group in groups for half in _halves(points, group)]
    return groups


def _halves(points: Array, group: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    if len(group) < 2:
        return [group]
    axis = int(np.ptp(points[group], axis=0).argmax())
    order = group[np.argsort(points[group, axis], kind="stable")]
    return [np.sort(order[: len(order) // 2]), np.sort(order[len(order) // 2 :])]


def _vector(values: Array) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


def _name(names: list[str], group: NDArray[np.int64]) -> str:
    """The first member, and how many others there are: "17+38"."""
    return names[group[0]] + (f"+{len(group) - 1}" if len(group) > 1 else "")


def _mean(values: Array, members: list[NDArray[np.int64]]) -> Array:
    """Of what is finite of values (frames, points, 3), by group, shape (frames, groups, 3); NaN where fewer than half are."""
    finite, filled = np.isfinite(values), np.nan_to_num(values)
    sums = np.stack([filled[:, group].sum(axis=1) for group in members], axis=1)
    counts = np.stack([finite[:, group].sum(axis=1) for group in members], axis=1)
    sizes = np.array([len(group) for group in members])[:, None]
    return np.where(2 * counts >= sizes, sums / np.maximum(counts, 1), np.nan)


def _ordered(data: xr.Dataset) -> xr.Dataset:
    return data.transpose("frame", "fiducial", "axis", "quaternion", ...)
