"""The noise of a force sensor, stated or seen in what it wrote."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bcid.inference.priors import PRIORS
from bcid.measurement import Measurement

Array = NDArray[np.float64]
# Standard deviation of Gaussian values per median of their sizes, and of their third differences per that of one.
_PER_MEDIAN, _THIRD = 1.4826, math.sqrt(20)


def force_noise(measurement: Measurement) -> tuple[float, float]:
    """Standard deviations of a force, N, and of a torque, N m.

    What is not stated is seen in third differences along the steps of each action, in which a smooth course drops out.
    """
    stated = measurement.wrench_sigma, measurement.torque_sigma
    force, torque = (
        _seen(measurement, measurement.wrenches[:, part]) if known is None else known
        for known, part in zip(stated, (slice(3), slice(3, 6)), strict=True)
    )
    return force, torque


def _seen(measurement: Measurement, values: Array) -> float:
    """Of values (frames, 3)."""
    differences = [np.diff(values[action.frames], 3, axis=0).ravel() for action in measurement.actions if action.grasp]
    sizes = np.abs(np.concatenate([np.zeros(0), *differences]))
    sizes = sizes[np.isfinite(sizes)]
    rough = _PER_MEDIAN * float(np.median(sizes)) / _THIRD if len(sizes) else 0.0
    return max(rough, PRIORS.force_sensor * float(np.nanmax(np.abs(values), initial=0.0)), 1e-12)
