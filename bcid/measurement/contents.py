"""What a measurement holds, as its files do: the arrays, their noise, points of the surface, and the units they came in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.base.units import unit_factor
from bcid.measurement.frame_error import FrameError
from bcid.scene.action import Action

FORMAT = "bcid-measurement/1"
AXES = ["x", "y", "z"]
WRENCH = ["fx", "fy", "fz", "tx", "ty", "tz"]
QUATERNION = ["qw", "qx", "qy", "qz"]
# What a measurement may state of its noise.
SIGMAS = ("noise_sigma", "wrench_sigma", "torque_sigma")
# A standard deviation, or that of each axis.
Sigma = float | tuple[float | None, ...] | None

Array = NDArray[np.float64]
# Action and step.
Frame = tuple[str, int]


def frames_of(data: xr.Dataset) -> tuple[Frame, ...]:
    """Action and step of each frame of a measurement's `data`."""
    keys = zip(data["action"].values.astype(str), data["step"].values.astype(int), strict=True)
    return tuple((str(action), int(step)) for action, step in keys)


@dataclass(frozen=True)
class Cloud:
    """Points on the surface of the body, and on whatever else is in view.

    Attributes:
        points: shape (n, 3), m.
        sigma: standard deviation of each along every axis, m; NaN where none is stated, shape (n,).
        frames: action and step of each frame in which something was seen.
        frame: number of the frame of each point, shape (n,).
        camera: where it is seen from, shape (3,), m; None where that is not known.
        noise: standard deviation that the points of the body have, as they were associated last, m; None before.
        counted: part of the points that were of the body then, and near a mark.
    """

    points: Array
    sigma: Array
    frames: tuple[Frame, ...]
    frame: NDArray[np.int64]
    camera: Array | None = None
    noise: float | None = None
    counted: float | None = None

    def numbers(self, data: xr.Dataset) -> NDArray[np.int64]:
        """The frame of a measurement's `data` that each point belongs to, -1 for those that are not in it, shape (n,)."""
        known = {frame: number for number, frame in enumerate(frames_of(data))}
        return np.array([known.get(frame, -1) for frame in self.frames], dtype=np.int64)[self.frame]

    def variables(self, data: xr.Dataset) -> dict[str, Any]:
        """Variables beside those of a measurement's `data`, from which `taken` takes it again."""
        numbers = self.numbers(data)
        kept = numbers >= 0
        return {
            "cloud": (("point", "axis"), self.points[kept]),
            "cloud_sigma": ("point", self.sigma[kept]),
            "cloud_frame": ("point", numbers[kept]),
            **({} if self.camera is None else {"cloud_camera": ("axis", self.camera)}),
        }

    @classmethod
    def taken(cls, data: xr.Dataset) -> tuple[Cloud | None, xr.Dataset]:
        """The cloud of a measurement's `data`, None where it holds none, and the data without it."""
        if not {"cloud", "cloud_sigma", "cloud_frame"} <= set(data.variables):
            return None, data
        points, sigma, frame = (np.asarray(data[name].values) for name in ("cloud", "cloud_sigma", "cloud_frame"))
        camera = np.asarray(data["cloud_camera"].values) if "cloud_camera" in data else None
        others = data.drop_dims("point").drop_vars("cloud_camera", errors="ignore")
        return cls(points, sigma, frames_of(data), frame.astype(np.int64), camera), others

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What tells it from others, by name."""
        found: dict[str, NDArray[Any]] = {
            "cloud_points": self.points,
            "cloud_sigma": self.sigma,
            "cloud_frame": self.frame,
        }
        found["cloud_frames"] = np.array([f"{action} {step}" for action, step in self.frames])
        return found if self.camera is None else found | {"cloud_camera": self.camera}


def with_noise(data: xr.Dataset, noise: Sigma) -> tuple[xr.Dataset, float | None]:
    """A dataset and the standard deviation that all axes have; those of single axes, m, are put where none is stated one by one."""
    if not isinstance(noise, tuple):
        return data, noise
    own = data["sigma"].values if "sigma" in data else np.full(data["position"].shape, np.nan)
    filled = np.where(np.isnan(own), np.array(noise, dtype=float), own)
    return data.assign(sigma=(("frame", "fiducial", "axis"), filled)), None


@dataclass(frozen=True)
class Units:
    """Units of the files, by name; numbers in memory are SI."""

    length: str = "mm"
    time: str = "s"
    force: str = "N"

    @property
    def factors(self) -> tuple[float, float, float]:
        """SI per unit of length, time and force.

        Raises:
            InputError: one of them is no such unit.
        """
        return unit_factor(self.length, "m"), unit_factor(self.time, "s"), unit_factor(self.force, "N")


@dataclass(frozen=True)
class Contents:
    """Trajectories of fiducials, motions of the gripper, and what else was recorded.

    `data` is an xarray Dataset with dimensions frame, fiducial, axis (and component, place): coordinates action, step,
    time (s); variables position (m, NaN where a fiducial was not seen), grasp, translation (m), rotation (unit
    quaternion), and optionally sigma (m), wrench (N, N m), load (N), and of surface marks the normal (frame, fiducial, axis) along
    which alone they are seen, NaN for fiducials; and of points that drive a place the displacement, drive (frame, point, axis), m,
    with the place, driven (point).

    Attributes:
        noise_sigma: per-axis standard deviation of a fiducial, m; None when not stated.
        wrench_sigma, torque_sigma: standard deviation of a force, N, and of a torque, N m; None when not stated.
        scale_sigma: relative standard deviation of the length of a pixel, a factor of all lengths from pictures; None when not
            stated.
        scale_of_gripper: whether the gripper's path was measured in the same pictures.
        frame_error: what is not known of the frame of the positions; None when nothing is stated.
        remarks: what looks odd, to be said before any result.
        cloud: points on the surface; None where there are none.
        left_out: frames that are not compared, as `data`; None where all are.
        aligned: RMS distance, m, by which the rigid motion of a mapping's [align] misses its markers; None without one.
    """

    data: xr.Dataset
    noise_sigma: float | None = None
    wrench_sigma: float | None = None
    units: Units = Units()
    description: str = ""
    source: str = "measurement"
    frame_error: FrameError | None = None
    remarks: tuple[str, ...] = ()
    aligned: float | None = None
    torque_sigma: float | None = None
    left_out: xr.Dataset | None = None
    cloud: Cloud | None = None
    scale_sigma: float | None = None
    scale_of_gripper: bool = False

    @property
    def fiducial_names(self) -> list[str]:
        """Names in the order of the fiducial axis."""
        return [str(name) for name in self.data["fiducial"].values]

    @property
    def positions(self) -> Array:
        """Measured positions, shape (frames, fiducials, 3), m; NaN where a fiducial was not seen."""
        return np.asarray(self.data["position"].values, dtype=float)

    @property
    def normals(self) -> Array | None:
        """The direction along which alone a surface mark is seen, (frames, fiducials, 3), NaN for fiducials; None without marks."""
        return np.asarray(self.data["normal"].values, dtype=float) if "normal" in self.data else None

    @property
    def wrenches(self) -> Array:
        """Measured force (N) and torque (N m) of the gripper, shape (frames, 6); NaN where there is none."""
        if "wrench" not in self.data:
            return np.full((self.data.sizes["frame"], len(WRENCH)), np.nan)
        return np.asarray(self.data["wrench"].transpose("frame", "component").values, dtype=float)

    @property
    def action_names(self) -> list[str]:
        """Names in the order of the files."""
        return list(dict.fromkeys(str(name) for name in self.data["action"].values))

    @property
    def actions(self) -> list[Action]:
        """The motions, in the order of the files."""
        return [self._action(name) for name in self.action_names]

    def _action(self, name: str) -> Action:
        frames = np.flatnonzero(self.data["action"].values.astype(str) == name)
        rows = self.data.isel(frame=frames)
        loads = {}
        if "load" in rows:
            for place in rows["place"].values:
                load = rows["load"].sel(place=place).values
                if np.any(load):
                    loads[str(place)] = np.asarray(load, dtype=float)
        boundary = {}
        if "drive" in rows:
            drive, owner = rows["drive"].transpose("frame", "point", "axis").values, rows["driven"].values.astype(str)
            boundary = {str(p): np.asarray(drive[:, owner == p], dtype=float) for p in dict.fromkeys(owner)}
        return Action(
            name,
            frames,
            rows["step"].values.astype(np.int64),
            str(rows["grasp"].values[0]),
            np.asarray(rows["translation"].values, dtype=float),
            np.asarray(rows["rotation"].values, dtype=float),
            loads,
            np.asarray(rows["time"].values, dtype=float),
            boundary=boundary,
        )

    def sigma(self, default: float | None = None) -> Array | None:
        """Standard deviation of every coordinate, shape (frames, fiducials, 3), m.

        Rows with their own sigma keep it; the others have `noise_sigma`, else `default`; None when none of them is
        known.
        """
        common = self.noise_sigma if self.noise_sigma is not None else default
        if "sigma" in self.data:
            own = np.asarray(self.data["sigma"].values, dtype=float)
            if common is None and np.isnan(own[~np.isnan(self.positions)]).any():
                return None
            return np.where(np.isnan(own), np.nan if common is None else common, own)
        return None if common is None else np.full(self.positions.shape, common)


def frames_dataset(frames: list[Frame], times: list[float], names: list[str], positions: np.ndarray) -> xr.Dataset:
    """Dataset of fiducial positions (frames, fiducials, 3) with the identity as motion of no grasp."""
    count = len(frames)
    return xr.Dataset(
        {
            "position": (("frame", "fiducial", "axis"), positions),
            "grasp": ("frame", [""] * count),
            "translation": (("frame", "axis"), np.zeros((count, 3))),
            "rotation": (("frame", "quaternion"), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))),
        },
        coords={
            "action": ("frame", [action for action, _ in frames]),
            "step": ("frame", np.array([step for _, step in frames], dtype=np.int32)),
            "time": ("frame", np.array(times)),
            "fiducial": names,
            "axis": AXES,
        },
    )


def motions_dataset(
    actions: Sequence[Action], times: list[float], names: list[str], positions: np.ndarray
) -> xr.Dataset:
    """Dataset of fiducial positions (frames, fiducials, 3) with motions that stand one after the other, at `times` (frames), s."""
    frames = [(action.name, int(step)) for action in actions for step in action.steps]
    data = frames_dataset(frames, times, names, positions)
    data["grasp"] = ("frame", [action.grasp for action in actions for _ in action.steps])
    data["translation"] = (("frame", "axis"), np.vstack([action.translation for action in actions]))
    data["rotation"] = (("frame", "quaternion"), np.vstack([action.rotation for action in actions]))
    return data
