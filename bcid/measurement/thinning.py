"""Recordings of many frames: some of each action are compared, and the others are left out as a test."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from bcid.measurement.measurement import Measurement
from bcid.scene import Scene

Array = NDArray[np.float64]
# Steps of an action that are compared besides rest, at most: each is a solve.
MOST = 60


def thinned(measurement: Measurement, most: int = MOST) -> Measurement:
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

    def to_json(self, length: float) -> dict[str, Any]:
        """For a run folder, lengths in units of `length` (m)."""
        return {"frames": self.frames, "rms": self.rms / length, "compared_rms": self.compared / length}

    def __str__(self) -> str:
        return (
            f"{self.frames} more frames were not compared, and are a test: the model misses them by {self.rms * 1e3:.3g} mm, "
            f"those that were compared by {self.compared * 1e3:.3g} mm"
        )

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
