"""Amounts of effects that follow a course in time, with what is not known of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from bcid.base.units import for_people
from bcid.report.figure import DARK, LIGHT, open_frame
from bcid.report.text import plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Half the width of an interval that holds 95 %, in standard errors.
_HALF = float(norm.ppf(0.975))
# Inches of a panel, and of a figure's lower edge.
_WIDTH, _HEIGHT, _EDGE = 4.6, 1.7, 0.7


def course_chart(courses: list[dict[str, Any]]) -> Figure:
    """The `courses` of a run's `diagnosis.json`, one below the other: values at knots, the course, and its 95 % band."""
    from matplotlib.figure import Figure

    height = _HEIGHT * len(courses) + _EDGE
    figure = Figure(figsize=(_WIDTH, height), facecolor="white", layout="constrained")
    panels = figure.subplots(len(courses), 1, sharex=True, squeeze=False)[:, 0]
    for axes, course in zip(panels, courses, strict=True):
        open_frame(axes)
        _draw(axes, course)
    panels[-1].set_xlabel("time (s)")
    return figure


def _draw(axes: Axes, course: dict[str, Any]) -> None:
    times = np.array(course["times"], dtype=float)
    shown = [
        for_people(value, error, course["unit"])
        for value, error in zip(course["values"], course["stderr"], strict=True)
    ]
    values = np.array([value for value, _, _ in shown])
    half = _HALF * np.array([np.nan if error is None else error for _, error, _ in shown])
    band: dict[str, Any] = {}
    line: dict[str, Any] = {"marker": "o", "markersize": 3.5}
    if course["stepwise"]:
        band, line = {"step": "post"}, {"drawstyle": "steps-post"}
        # The last value holds on.
        times = np.append(times, 2 * times[-1] - times[-2])
        values, half = np.append(values, values[-1]), np.append(half, half[-1])
    if np.isfinite(half).any():
        axes.fill_between(times, values - half, values + half, color=LIGHT, linewidth=0, **band)
    axes.plot(times, values, color=DARK, linewidth=1.6, **line)
    axes.axhline(0.0, color="#dddddd", linewidth=1, zorder=0)
    unit = "" if course["unit"] == "1" else f" ({shown[0][2]})"
    at = f" at {course['place']}" if course["place"] else ""
    axes.set_ylabel(f"{plain(course['effect'])}{at}\n{plain(course['amount'])}{unit}")
