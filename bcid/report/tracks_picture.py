"""What `bcid track` and `bcid import` show: where markers were seen, when, how well, and how far they go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bcid.base.run_folder import RunFolder, writing
from bcid.report.figure import DARK, GREY, save, short, styled
from bcid.report.picture_file import Pixels, decoded

Array = NDArray[np.float64]

# Okabe & Ito.
_ORANGE, _SEEN = "#d55e00", "#dce9f2"
# The picture of the images at rest, which a tracking wrote, and the height of the line of text above them, px.
REST, _LINE = "rest.png", 44
# Numbers along the longest axis, about.
_TICKS = 6
# Markers and frames of a recording that are drawn: more cannot be told apart. Markers whose names are written.
_MARKERS, _FRAMES, _NAMED = 200, 1000, 30


def rest_picture(run: RunFolder) -> Pixels | None:
    """The images at rest of a tracking run; None where it wrote none.

    Raises:
        InputError: the file is missing or damaged.
    """
    return decoded(run.read_bytes(REST), run.path / REST) if run.holds(REST) else None


def tracking_figure(found: dict[str, Any], data: xr.Dataset, rest: Pixels | None) -> Figure:
    """The images at rest above; seen and hidden beads, standard deviations and the cameras' agreement below."""
    pictured = rest is not None
    figure = Figure(figsize=(12, 9.4 if pictured else 4.6), facecolor="white")
    rows = [1.55, 1] if pictured else [1]
    grid = figure.add_gridspec(len(rows), 3, height_ratios=rows, width_ratios=[1.5, 1, 1], hspace=0.12, wspace=0.3)
    grid.update(left=0.06, right=0.98, top=0.92 if pictured else 0.86, bottom=0.08 if pictured else 0.14)
    sigma = f"{found['sigma'] * 1e3:.2g}"
    title = f"{found['beads']} beads in {found['frames']} pairs of images: {found['seen']:.1%} seen, standard deviation {sigma} mm"
    figure.suptitle(title, x=0.02, ha="left", fontsize=14, fontweight="bold")
    if found["warnings"]:
        text = f"{len(found['warnings'])} warning(s): see summary.txt"
        figure.text(0.02, 0.935 if pictured else 0.89, text, color=_ORANGE)
    if rest is not None:
        axes = figure.add_subplot(grid[0, :])
        axes.imshow(rest[_LINE:])
        axes.set_axis_off()
        _title(axes, "the first images, left and right: circles around the beads that were found")
    axes = figure.add_subplot(grid[-1, 0])
    seen = np.isfinite(data["position"].values).all(axis=2).T
    _draw_gaps(axes, seen, [str(name) for name in data["fiducial"].values])
    for begin in np.flatnonzero(data["step"].values == 0)[1:]:
        axes.axvline(begin - 0.5, color="black", linewidth=0.8)
    axes.set_xlabel("pair of images")
    axes.set_ylabel("bead")
    _draw_deviations(figure.add_subplot(grid[-1, 1]), data)
    _draw_agreement(figure.add_subplot(grid[-1, 2]), data)
    return figure


def draw_tracks(points: Mapping[str, Array], times: Array, unit: str, title: str, target: Path) -> Path:
    """Draw positions by label, shape (frames, 3), in `unit`, over times (frames,) in s; returns `target`."""
    clock = "time, s"
    if (np.diff(times) < 0).any():
        # Several actions, each with a clock of its own.
        times, clock = np.arange(len(times), dtype=float), "frame"
    every = max(1, -(-len(points) // _MARKERS)), max(1, -(-len(times) // _FRAMES))
    chosen = {label: at[:: every[1]] for label, at in list(points.items())[:: every[0]]}
    with styled(), writing(target.parent):
        return save(_tracks_figure(chosen, times[:: every[1]], unit, title, clock), target)


def _tracks_figure(points: Mapping[str, Array], times: Array, unit: str, title: str, clock: str) -> Figure:
    """Paths in space on the left; gaps and distances from the first position on the right."""
    figure = Figure(figsize=(11, 5.6), facecolor="white", layout="constrained")
    figure.suptitle(title, x=0.02, ha="left", fontsize=13, fontweight="bold")
    grid = figure.add_gridspec(2, 2, width_ratios=[1.25, 1])
    _draw_paths(figure.add_subplot(grid[:, 0], projection="3d"), points, unit)
    seen = np.array([np.isfinite(at).all(axis=1) for at in points.values()])
    extent = (times[0], max(times[-1], times[0] + 1e-9), len(points) - 0.5, -0.5)
    names = [short(label) for label in points] if len(points) <= _NAMED else None
    _draw_gaps(figure.add_subplot(grid[0, 1]), seen, names, extent)
    axes = figure.add_subplot(grid[1, 1])
    for at, known in zip(points.values(), seen, strict=True):
        if known.any():
            axes.plot(times, np.linalg.norm(at - at[known.argmax()], axis=1), color=DARK, linewidth=0.8)
    axes.set_xlabel(clock)
    axes.set_ylabel(f"moved, {unit}")
    _title(axes, "distance from the first position")
    return figure


def _title(axes: Axes, text: str) -> None:
    axes.set_title(text, loc="left", fontsize=10)


def _draw_gaps(axes: Axes, seen: NDArray[np.bool_], names: Sequence[str] | None, extent: Any = None) -> None:
    """Which marker was seen in which frame, shape (markers, frames)."""
    colours = ListedColormap([_ORANGE, _SEEN])
    axes.imshow(seen, aspect="auto", cmap=colours, vmin=0, vmax=1, extent=extent, interpolation="nearest")
    axes.spines[:].set_visible(True)
    if names is not None:
        axes.set_yticks(range(len(names)), names, fontsize=7)
    _title(axes, "gaps (orange)")


def _draw_deviations(axes: Axes, data: xr.Dataset) -> None:
    """Standard deviation of the positions, along the best and the worst direction of each."""
    covariance = data["covariance"].values.reshape(-1, 3, 3)
    covariance = covariance[np.isfinite(covariance).all(axis=(1, 2))]
    sizes = np.sqrt(np.linalg.eigvalsh(covariance)) * 1e3
    bins = list(np.linspace(0, np.quantile(sizes[:, 2], 0.98) * 1.1 + 1e-9, 40))
    axes.hist(sizes[:, 0], bins=bins, color=DARK, label="best direction")
    axes.hist(sizes[:, 2], bins=bins, histtype="step", color=_ORANGE, linewidth=2, label="worst (depth)")
    axes.set_xlabel("standard deviation, mm")
    axes.set_ylabel("positions")
    axes.legend(frameon=False, fontsize=9)


def _draw_agreement(axes: Axes, data: xr.Dataset) -> None:
    """Misfit of the two cameras against what its chi-square distribution has."""
    from scipy.stats import chi2

    misfit = np.sort(data["misfit"].values[np.isfinite(data["misfit"].values)])
    share = (np.arange(len(misfit)) + 0.5) / max(len(misfit), 1)
    axes.plot(np.sqrt(misfit), share, color=DARK, linewidth=2, label="found")
    x = np.linspace(0, 4, 200)
    axes.plot(x, chi2.cdf(x**2, 1), color="#bbbbbb", linewidth=2, linestyle="--", label="expected")
    axes.set_xlim(0, max(4, float(np.sqrt(misfit[int(0.98 * (len(misfit) - 1))])) if len(misfit) else 4))
    axes.set_xlabel("distance of the rays, st. dev.")
    axes.set_ylabel("share of positions")
    axes.legend(frameon=False, fontsize=9)


def _draw_paths(axes: Any, points: Mapping[str, Array], unit: str) -> None:
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
    _title(axes, "paths; dots where they begin")
