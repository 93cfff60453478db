"""Charts over frames and times: force and torque of the gripper, and amounts of effects with what is not known of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bcid.base.tails import normal_quantile
from bcid.base.units import for_people
from bcid.report.figure import DARK, LIGHT, chart, name_frames
from bcid.results.diagnosis_record import TimeHistory
from bcid.results.words import plain

Array = NDArray[np.float64]
# Of x, y and z (Okabe & Ito).
_COLOURS = ("#0072b2", "#d55e00", "#009e73")
# Half the width of an interval that holds 95 %, in standard errors.
_HALF = normal_quantile(0.975)
# Between the light band and the dark line.
_MIDDLE = "#5fa8d6"
# Inches of a panel of courses, and of a figure's lower edge.
_WIDTH, _HEIGHT, _EDGE = 4.6, 1.7, 0.7


def felt(positions: xr.Dataset) -> bool:
    """Whether a run's `residuals.nc` or `prediction.nc` holds measured forces."""
    return "wrench_measured" in positions and bool(np.isfinite(positions["wrench_measured"].values).any())


def force_chart(positions: xr.Dataset) -> Figure:
    """Force along each axis, N."""
    return chart(lambda axes: _draw_wrench(axes, positions, slice(3), 1.0, "force (N)"), columns=5)


def torque_chart(positions: xr.Dataset) -> Figure:
    """Torque about each axis, N mm."""
    return chart(lambda axes: _draw_wrench(axes, positions, slice(3, 6), 1e-3, "torque (N mm)"), columns=5)


def _draw_wrench(axes: Axes, positions: xr.Dataset, part: slice, unit: float, label: str) -> None:
    """Marks for what was measured, lines for what the last model predicts; actions apart."""
    predicted = positions["wrench_predicted" if "wrench_predicted" in positions else "wrench"].values[:, part] / unit
    measured = positions["wrench_measured"].values[:, part] / unit
    actions = positions["action"].values.astype(str)
    frames = np.arange(len(actions))
    for k, (axis, colour) in enumerate(zip("xyz", _COLOURS, strict=True)):
        axes.plot(frames, measured[:, k], "o", color=colour, markersize=3.5, label=axis)
        for name in dict.fromkeys(actions):
            own = actions == name
            axes.plot(frames[own], predicted[own, k], color=colour, linewidth=1.6)
    axes.plot([], [], "o", color="#444444", markersize=3.5, label="measured")
    axes.plot([], [], color="#444444", linewidth=1.6, label="predicted")
    name_frames(axes, actions, color="#dddddd", linewidth=1)
    axes.set_ylabel(label)


def course_chart(histories: Sequence[TimeHistory]) -> Figure:
    """The time histories of a diagnosis, one below the other: values at knots, the course, and its 95 % band."""
    height = _HEIGHT * len(histories) + _EDGE
    figure = Figure(figsize=(_WIDTH, height), facecolor="white", layout="constrained")
    panels = figure.subplots(len(histories), 1, sharex=True, squeeze=False)[:, 0]
    for axes, course in zip(panels, histories, strict=True):
        _draw_course(axes, course)
    panels[-1].set_xlabel("time (s)")
    return figure


def _draw_course(axes: Axes, course: TimeHistory) -> None:
    times, values = np.array(course.times, dtype=float), course.values
    unit = for_people(1.0, None, course.unit)
    line: dict[str, Any] = {"marker": "o", "markersize": 3.5}
    band: dict[str, Any] = {"linewidth": 0}
    steps = bool(course.stepwise)
    if steps:
        # The last value holds on.
        times = np.append(times, 2 * times[-1] - times[-2])
        line, band = {"drawstyle": "steps-post"}, band | {"step": "post"}

    def shown(numbers: Sequence[float | None]) -> Array:
        found = unit[0] * np.array([np.nan if number is None else number for number in numbers])
        return np.append(found, found[-1]) if steps else found

    middle = shown(values)
    for errors, colour in ((course.stderr, LIGHT), (course.stderr_from_mean, _MIDDLE)):
        half = _HALF * shown(errors or [None] * len(values))
        if np.isfinite(half).any():
            axes.fill_between(times, middle - half, middle + half, color=colour, **band)
    axes.plot(times, middle, color=DARK, linewidth=1.6, **line)
    axes.axhline(0.0, color="#dddddd", linewidth=1, zorder=0)
    name = "" if course.unit == "1" else f" ({unit[2]})"
    at = f" at {course.place}" if course.place else ""
    axes.set_ylabel(f"{plain(course.effect)}{at}\n{plain(course.amount)}{name}")
