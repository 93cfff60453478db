"""What `bcid calibrate` shows: where corners lie in the images, what the cameras miss them by, and the error of each pair."""

from __future__ import annotations

import math
import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bcid.report.figure import name_ticks, round_length

Array = NDArray[np.float64]

# Okabe & Ito; the marks differ as well.
_COLOURS = {"left": "#0072B2", "right": "#D55E00"}
_MARKS = {"left": "o", "right": "^"}
_LEFT_OUT = "#BBBBBB"
_CELL = "#EAF3EE"
# Arrows that an image may hold, and the length of a typical one as a share of its width.
_ARROWS, _LENGTH = 700, 0.018
# Letters of a line of the title.
_LINE = 105
# Room for bars: few are not broad.
_BARS = 10


def calibration_figure(found: dict[str, Any]) -> Figure:
    """The two images with corners and residuals above; the errors of the pairs and all residuals below."""
    figure = Figure(figsize=(12, 8.4), facecolor="white")
    lines = textwrap.wrap(f"calibration: {found['verdict']}", _LINE)
    figure.text(0.02, 0.975, "\n".join(lines), ha="left", va="top", fontsize=14, fontweight="bold")
    figure.text(0.02, 0.972 - 0.031 * len(lines), _subtitle(found), ha="left", va="top", fontsize=10.5, color="#333333")
    grid = figure.add_gridspec(2, 1, height_ratios=[1.55, 1], hspace=0.24)
    grid.update(left=0.06, right=0.98, top=0.87 - 0.031 * (len(lines) - 1), bottom=0.075)
    above = grid[0].subgridspec(1, 2, wspace=0.1)
    below = grid[1].subgridspec(1, 2, wspace=0.2, width_ratios=[2.3, 1])
    for k, side in enumerate(("left", "right")):
        _image(figure.add_subplot(above[k]), found, side)
    _pairs(figure.add_subplot(below[0]), found)
    _residuals(figure.add_subplot(below[1]), found)
    return figure


def _subtitle(found: dict[str, Any]) -> str:
    baseline, angle = found["baseline"], found["angle"]
    corners = sum(len(pair["board"]) for pair in found["pairs"])
    return (
        f"error {found['error']:.3f} px RMS over {corners} corners of {len(found['pairs'])} pairs;  "
        f"baseline {baseline['value'] * 1e3:.2f}{_plus_minus(baseline, 1e3)} mm;  "
        f"angle between the axes {angle['value']:.2f}{_plus_minus(angle)} deg"
    )


def _plus_minus(number: dict[str, Any], factor: float = 1.0) -> str:
    return "" if number["deviation"] is None else f" ± {_digits(number['deviation'] * factor)}"


def _digits(value: float) -> str:
    """Two digits, and never a power of ten for a large number."""
    return f"{value:.0f}" if value >= 100 else f"{value:.2g}"


def _image(axes: Axes, found: dict[str, Any], side: str) -> None:
    """Frame of the images of one camera: cells that hold corners, corners, and residuals as arrows."""
    width, height = found[side]["size"]
    pixels, residuals = _stacked(found, side), _stacked(found, f"{side}_residuals")
    _cells(axes, pixels, (width, height), found["grid"])
    axes.plot(*pixels.T, ".", color="#777777", ms=1.6, zorder=2)
    # A typical residual gets a length that can be seen.
    factor = round_length(_LENGTH * width / max(found["error"], 1e-12))
    step = math.ceil(len(pixels) / _ARROWS)
    shown, ends = pixels[::step], residuals[::step] * factor
    head: dict[str, Any] = {"width": 0.0022, "headwidth": 3.5, "headlength": 4, "color": _COLOURS[side]}
    axes.quiver(*shown.T, *ends.T, angles="xy", scale_units="xy", scale=1, zorder=3, **head)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal", anchor="W")
    axes.spines[:].set_visible(True)
    axes.tick_params(labelsize=8)
    arrows = f"arrows: found minus projected, × {factor:g}" + (f", one corner in {step}" if step > 1 else "")
    focal = {"value": found[side]["matrix"][0][0], "deviation": found[side]["deviations"]["fx"]}
    about = f"{side}: f = {focal['value']:.1f}{_plus_minus(focal)} px, error {found[side]['error']:.3f} px, corners"
    axes.set_title(f"{about} in {found[side]['coverage']:.0%} of the cells\n{arrows}", loc="left", fontsize=9.5)


def _cells(axes: Axes, pixels: Array, size: tuple[int, int], grid: list[int]) -> None:
    """The coverage grid; cells with corners are shaded."""
    across, down = (np.linspace(-0.5, length - 0.5, count + 1) for length, count in zip(size, grid, strict=True))
    counts = np.histogram2d(pixels[:, 0], pixels[:, 1], bins=[across, down])[0]
    shades = ListedColormap(["white", _CELL])
    axes.pcolormesh(across, down, np.where(counts.T > 0, 1.0, 0.0), cmap=shades, vmin=0, vmax=1, zorder=0)
    for k, lines in enumerate((across, down)):
        for at in lines[1:-1]:
            (axes.axhline if k else axes.axvline)(at, color="#CCCCCC", lw=0.6, zorder=1)


def _pairs(axes: Axes, found: dict[str, Any]) -> None:
    """Error of each pair as a bar, in the order of their numbers; those left out are hatched."""
    outside = {pair["number"]: pair["error"] for pair in found["left_out"]}
    errors = dict(sorted(({pair["number"]: pair["error"] for pair in found["pairs"]} | outside).items()))
    # A pair that is far off would make all other bars flat.
    top = 1.35 * max(pair["error"] for pair in found["pairs"])
    for place, (number, error) in enumerate(errors.items()):
        style: dict[str, Any] = {"color": "#009E73"}
        if number in outside:
            style = {"color": _LEFT_OUT, "hatch": "///", "edgecolor": "white"}
            box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
            about: dict[str, Any] = {"rotation": 90, "ha": "center", "va": "center", "fontsize": 8, "bbox": box}
            axes.text(place, top / 2, f"left out, {error:.3g} px", **about)
        axes.bar(place, min(error, top), 0.75, **style)
    axes.axhline(found["error"], color="black", lw=1, ls="--")
    beside: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "va": "center"}
    axes.annotate(f"all: {found['error']:.3f}", (1, found["error"]), xytext=(2, 0), fontsize=8, **beside)
    axes.set_ylim(0, top)
    axes.set_xlim(-0.6, max(len(errors), _BARS) - 0.4)
    name_ticks(axes, list(errors))
    axes.set_xlabel("pair")
    axes.set_ylabel("error (px RMS)")


def _residuals(axes: Axes, found: dict[str, Any]) -> None:
    """All residuals of both cameras."""
    both = {side: _stacked(found, f"{side}_residuals") for side in _COLOURS}
    reach = max(np.abs(residuals).max() for residuals in both.values()) * 1.08 or 1.0
    for side, residuals in both.items():
        axes.plot(*residuals.T, _MARKS[side], color=_COLOURS[side], ms=2.4, mew=0, alpha=0.45, label=side)
    axes.axhline(0, color="black", lw=0.6)
    axes.axvline(0, color="black", lw=0.6)
    axes.set_xlim(-reach, reach)
    axes.set_ylim(reach, -reach)
    axes.set_aspect("equal")
    axes.set_xlabel("found minus projected, u (px)")
    axes.set_ylabel("v (px)")
    legend = axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=9, markerscale=2.5)
    for handle in legend.legend_handles:
        if handle is not None:
            handle.set_alpha(1.0)


def _stacked(found: dict[str, Any], name: str) -> Array:
    """Rows (n, 2) of all pairs that were used."""
    return np.vstack([np.array(pair[name], dtype=float).reshape(-1, 2) for pair in found["pairs"]])
