"""Points that a depth camera saw of the surface: any number in each step, and no knowing which is which."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

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
        names = np.array([f"{action} {step}" for action, step in self.frames])
        found = {
            "cloud_points": self.points,
            "cloud_sigma": self.sigma,
            "cloud_frames": names,
            "cloud_frame": self.frame,
        }
        return found if self.camera is None else found | {"cloud_camera": self.camera}
