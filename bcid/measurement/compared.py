"""What of a measurement is compared: what lies in the plane of a sheet, means of dense points, and some of many frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from bcid.base.errors import Problems
from bcid.measurement.contents import AXES, WRENCH
from bcid.measurement.measurement import Measurement
from bcid.scene import Scene
from bcid.scene.parts import Vector
from bcid.scene.rotation import as_rotation

Array = NDArray[np.float64]
# A gripper may leave the plane of a sheet by this part of the extent of markers and grasps, and tilt by this angle (rad). Lengths
# in the plane then err by half the square of it: 0.1 %.
_OUT = 0.05
_ACROSS = ("fz", "tx", "ty")
# So many fiducials are taken one by one; more are halved until there are at most so many groups.
MOST_FIDUCIALS = 128
# Steps of an action that are compared besides rest, at most: each is a solve.
MOST_STEPS = 60


def in_plane(scene: Scene, measurement: Measurement) -> Measurement:
    """Of a sheet, the measurement without coordinates and forces across its plane; of other bodies as it is.

    Raises:
        InputError: the gripper leaves the plane of a sheet.
    """
    if not scene.thickness:
        return measurement
    _refuse_lifted(scene, measurement)
    data = measurement.data.copy(deep=True)
    data["position"][{"axis": 2}] = np.nan
    if "wrench" in data:
        data["wrench"][{"component": [WRENCH.index(name) for name in _ACROSS]}] = np.nan
    return replace(measurement, data=data)


def _refuse_lifted(scene: Scene, measurement: Measurement) -> None:
    problems = Problems(f"measurement {measurement.source} does not fit scene {scene.source}")
    points = np.vstack([scene.rest, *(np.array(grasp.centre)[None] for grasp in scene.grasps.values())])
    size = float(np.linalg.norm(np.ptp(points[:, :2], axis=0)))
    for action in measurement.actions:
        if not action.grasp:
            continue
        lift = float(np.abs(action.translation[:, 2]).max())
        upright = as_rotation(action.rotation).apply([0.0, 0.0, 1.0])[:, 2].min()
        tilt = float(np.arccos(np.clip(upright, -1.0, 1.0)))
        if lift > _OUT * size or tilt > _OUT:
            problems.add(
                measurement.source,
                f"action {action.name}: the gripper leaves the plane of the sheet, by up to {lift * 1e3:.3g} mm and "
                f"{np.degrees(tilt):.3g} deg; a sheet (geometry.thickness) stays within {_OUT * size * 1e3:.3g} mm "
                f"and {np.degrees(_OUT):.2g} deg of its plane: name a geometry of tetrahedra, or leave this action out",
            )
    problems.raise_if_any()


def pooled(scene: Scene, measurement: Measurement, most: int = MOST_FIDUCIALS) -> tuple[Scene, Measurement]:
    """Both with the means of neighbours at rest as fiducials, where more than `most` were seen; else as they are.

    What a body does varies over its elements, and neighbours share all that is not noise: the mean displacement of a group tells as
    much as its members do, with their noise divided by the root of their number, and costs do not grow with the points.
    A prediction of a group is the mean of those of its members. One that is seen in part, at least by half, has the displacement of
    those that are. Stated noises are taken for independent; where neighbours share theirs the residual tells.
    """
    once = np.flatnonzero(np.isfinite(measurement.positions).any(axis=(0, 2)))
    if len(once) <= most:
        return scene, measurement
    names = [measurement.fiducial_names[k] for k in once]
    rest = np.array([scene.fiducials[name] for name in names], dtype=float)
    groups = {_name(names, group): group for group in halved_groups(rest, most)}
    members = {name: tuple(map(_vector, rest[group])) for name, group in groups.items()}
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


def thinned(measurement: Measurement, most: int = MOST_STEPS) -> Measurement:
    """The measurement with rest and at most so many steps of each action, evenly spread; the others in `left_out`.

    Points of a surface stay as they are.
    """
    if measurement.cloud is not None or all(len(action) <= most + 1 for action in measurement.actions):
        return measurement
    kept = np.sort(np.concatenate([action.frames[spread(len(action), most)] for action in measurement.actions]))
    others = np.setdiff1d(np.arange(measurement.data.sizes["frame"]), kept)
    data = measurement.data
    return replace(measurement, data=data.isel(frame=kept), left_out=data.isel(frame=others))


def spread(count: int, steps: int) -> NDArray[np.int64]:
    """The first of so many, and at most `steps` more up to the last, evenly spread."""
    return np.unique(np.linspace(0, count - 1, steps + 1).round().astype(int))


@dataclass(frozen=True)
class LeftOut:
    """How well a model shows the frames that it was not compared with.

    Attributes:
        frames: how many there are.
        rms: RMS residual of a coordinate there, m.
        compared: the same in the frames that were compared, m.
    """

    frames: int
    rms: float
    compared: float

    @classmethod
    def of(cls, scene: Scene, measurement: Measurement, predicted: Array) -> LeftOut | None:
        """Of what a model shows in the compared frames, (frames, rows, 3), m, fiducials of the scene first; None where all are.

        What it shows in others is interpolated along an action (Fritsch & Carlson, SIAM J. Numer. Anal. 17, 1980, 238).
        """
        others = measurement.left_out
        if others is None:
            return None
        predicted = predicted[:, [scene.fiducial_names.index(name) for name in measurement.fiducial_names]]
        action, step = others["action"].values.astype(str), others["step"].values
        shown = np.full(others["position"].shape, np.nan)
        for one in measurement.actions:
            here = np.flatnonzero(action == one.name)
            known = np.isfinite(predicted[one.frames]).all(axis=(1, 2))
            if len(here) and known.sum() > 1:
                between = PchipInterpolator(one.steps[known], predicted[one.frames][known], axis=0, extrapolate=False)
                shown[here] = between(step[here])
        # What was left out of the compared frames as well tells nothing.
        shown[:, ~np.isfinite(measurement.positions).any(axis=(0, 2))] = np.nan
        found = [_rms(others["position"].values - shown), _rms(measurement.positions - predicted)]
        return cls(len(action), *found) if np.isfinite(found).all() else None


def _rms(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else np.nan
