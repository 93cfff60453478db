"""Force and torque of the gripper, measured and predicted, frame by frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.base.units import unit_factor
from bcid.report.figure import chart, legend_below, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
# Of x, y and z (Okabe & Ito).
_COLOURS = ("#0072b2", "#d55e00", "#009e73")


def felt(positions: xr.Dataset) -> bool:
    """Whether a run's `residuals.nc` or `prediction.nc` holds measured forces."""
    return "wrench_measured" in positions and bool(np.isfinite(positions["wrench_measured"].values).any())


def force_chart(positions: xr.Dataset) -> Figure:
    """Force along each axis, N."""
    return _chart(positions, slice(3), 1.0, "force (N)")


def torque_chart(positions: xr.Dataset, length: str) -> Figure:
    """Torque about each axis, N times a unit of length."""
    return _chart(positions, slice(3, 6), unit_factor(length, "m"), f"torque (N {length})")


def _chart(positions: xr.Dataset, part: slice, unit: float, label: str) -> Figure:
    """Marks for what was measured, lines for what the last model predicts; actions apart."""
    figure, axes = chart()
    predicted = positions["wrench_predicted" if "wrench_predicted" in positions else "wrench"].values[:, part] / unit
    measured = positions["wrench_measured"].values[:, part] / unit
    actions = positions["action"].values.astype(str)
    frames = np.arange(len(actions))
    begins = [int(np.flatnonzero(actions == name)[0]) for name in dict.fromkeys(actions)]
    for k, (axis, colour) in enumerate(zip("xyz", _COLOURS, strict=True)):
        axes.plot(frames, measured[:, k], "o", color=colour, markersize=3.5, label=axis)
        for name in dict.fromkeys(actions):
            own = actions == name
            axes.plot(frames[own], predicted[own, k], color=colour, linewidth=1.6)
    for begin in begins[1:]:
        axes.axvline(begin - 0.5, color="#dddddd", linewidth=1)
    axes.plot([], [], "o", color="#444444", markersize=3.5, label="measured")
    axes.plot([], [], color="#444444", linewidth=1.6, label="predicted")
    few = max(1, -(-len(begins) // 10))
    axes.set_xticks(begins[::few], [short(actions[begin]) for begin in begins[::few]], ha="left")
    axes.set_xlabel("frames of action")
    axes.set_ylabel(label)
    legend_below(figure, axes, 5)
    return figure
