"""What `bcid import` shows: the paths of markers in space, when each is seen, and how far each goes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.run_folder import writing
from bcid.report.figure import DARK, GREY, open_frame, save, short, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

# Numbers along the longest axis, about.
_TICKS = 6
# Markers and frames that are drawn: more cannot be told apart.
_MARKERS, _FRAMES = 200, 1000
# Markers whose names are written.
_NAMED = 30


def draw_tracks(points: Mapping[str, Array], times: Array, unit: str, title: str, target: Path) -> Path:
    """Draw positions by label, shape (frames, 3), in `unit`, over times (frames,) in s; returns `target`."""
    if (np.diff(times) < 0).any():
        # Several actions, each with a clock of its own.
        times, clock = np.arange(len(times), dtype=float), "frame"
    else:
        clock = "time, s"
    every = max(1, -(-len(points) // _MARKERS)), max(1, -(-len(times) // _FRAMES))
    chosen = {label: at[:: every[1]] for label, at in list(points.items())[:: every[0]]}
    with styled(), writing(target.parent):
        return save(tracks_figure(chosen, times[:: every[1]], unit, title, clock), target)


def tracks_figure(points: Mapping[str, Array], times: Array, unit: str, title: str, clock: str = "time, s") -> Figure:
    """Paths in space on the left; gaps and distances from the first position on the right."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.6), facecolor="white", layout="constrained")
    figure.suptitle(title, x=0.02, ha="left", fontsize=13, fontweight="bold")
    grid = figure.add_gridspec(2, 2, width_ratios=[1.25, 1])
    _paths(figure.add_subplot(grid[:, 0], projection="3d"), points, unit)
    _seen(figure.add_subplot(grid[0, 1]), points, times)
    _moved(figure.add_subplot(grid[1, 1]), points, times, unit, clock)
    return figure


def _paths(axes: Any, points: Mapping[str, Array], unit: str) -> None:
    """Each path with a dot where it begins."""
    for label, at in points.items():
        seen = at[np.isfinite(at).all(axis=1)]
        axes.plot(*at.T, color=DARK, linewidth=1.0)
        if len(seen):
            axes.plot(*seen[:1].T, "o", color=GREY, markersize=3.5)
            if len(points) <= _NAMED:
                axes.text(*seen[0], f" {short(label)}", fontsize=8)
    extents = np.array([np.ptp(getattr(axes, f"get_{name}lim")()) for name in "xyz"])
    for name, part in zip("xyz", extents / extents.max(), strict=True):
        getattr(axes, f"set_{name}label")(f"{name}, {unit}")
        # With one scale for all axes a short one has room for few numbers.
        axes.locator_params(axis=name, nbins=max(1, round(_TICKS * part)))
    axes.tick_params(labelsize=8)
    axes.set_aspect("equal")  # one scale for all axes
    axes.set_title("paths; dots where they begin", loc="left", fontsize=10)


def _seen(axes: Axes, points: Mapping[str, Array], times: Array) -> None:
    from matplotlib.colors import ListedColormap

    seen = np.array([np.isfinite(at).all(axis=1) for at in points.values()])
    extent = (times[0], max(times[-1], times[0] + 1e-9), len(points) - 0.5, -0.5)
    colours = ListedColormap(["#D55E00", "#DCE9F2"])
    axes.imshow(seen, aspect="auto", cmap=colours, vmin=0, vmax=1, extent=extent, interpolation="nearest")
    if len(points) <= _NAMED:
        axes.set_yticks(range(len(points)), [short(label) for label in points], fontsize=7)
    axes.set_title("gaps (orange)", loc="left", fontsize=10)


def _moved(axes: Axes, points: Mapping[str, Array], times: Array, unit: str, clock: str) -> None:
    for at in points.values():
        seen = np.flatnonzero(np.isfinite(at).all(axis=1))
        if len(seen):
            axes.plot(times, np.linalg.norm(at - at[seen[0]], axis=1), color=DARK, linewidth=0.8)
    axes.set_xlabel(clock)
    axes.set_ylabel(f"moved, {unit}")
    axes.set_title("distance from the first position", loc="left", fontsize=10)
    open_frame(axes)
