"""Amounts of effects that follow a course in time, with what is not known of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.tails import normal_quantile
from bcid.base.units import for_people
from bcid.report.figure import DARK, LIGHT, open_frame
from bcid.report.text import plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
# Half the width of an interval that holds 95 %, in standard errors.
_HALF = normal_quantile(0.975)
# Between the light band and the dark line.
_MIDDLE = "#5fa8d6"
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
    times, values = np.array(course["times"], dtype=float), course["values"]
    unit = for_people(1.0, None, course["unit"])
    line: dict[str, Any] = {"marker": "o", "markersize": 3.5}
    band: dict[str, Any] = {"linewidth": 0}
    steps = bool(course["stepwise"])
    if steps:
        # The last value holds on.
        times = np.append(times, 2 * times[-1] - times[-2])
        line, band = {"drawstyle": "steps-post"}, band | {"step": "post"}

    def shown(numbers: list[float | None]) -> Array:
        found = unit[0] * np.array([np.nan if number is None else number for number in numbers])
        return np.append(found, found[-1]) if steps else found

    middle = shown(values)
    for errors, colour in ((course["stderr"], LIGHT), (course.get("stderr_apart"), _MIDDLE)):
        half = _HALF * shown(errors or [None] * len(values))
        if np.isfinite(half).any():
            axes.fill_between(times, middle - half, middle + half, color=colour, **band)
    axes.plot(times, middle, color=DARK, linewidth=1.6, **line)
    axes.axhline(0.0, color="#dddddd", linewidth=1, zorder=0)
    name = "" if course["unit"] == "1" else f" ({unit[2]})"
    at = f" at {course['place']}" if course["place"] else ""
    axes.set_ylabel(f"{plain(course['effect'])}{at}\n{plain(course['amount'])}{name}")
