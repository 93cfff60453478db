"""The xarray dataset of a measurement, as readers and simulations begin it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from bcid.measurement.cloud import Frame
from bcid.measurement.contents import AXES
from bcid.scene.action import Action


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
