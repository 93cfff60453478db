"""What `bcid track` shows: the first images with the beads that were found, and when, how well and where each bead was seen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from bcid.base.run_folder import RunFolder
from bcid.report.figure import open_frame
from bcid.report.picture_file import Pixels, decoded

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe & Ito.
_BLUE, _ORANGE, _GREY = "#0072B2", "#D55E00", "#BBBBBB"
# The picture of the images at rest, which the run wrote.
REST = "rest.png"
# Height of the line of text above the images of rest.png, px.
_LINE = 44


def rest_picture(run: RunFolder) -> Pixels | None:
    """The images at rest of a tracking run; None where it wrote none.

    Raises:
        InputError: the file is missing or damaged.
    """
    return decoded(run.read_bytes(REST), run.path / REST) if run.holds(REST) else None


def tracking_figure(found: dict[str, Any], data: xr.Dataset, rest: Pixels | None) -> Figure:
    """The images at rest above; seen and hidden beads, standard deviations and the cameras' agreement below."""
    from matplotlib.figure import Figure

    pictured = rest is not None
    figure = Figure(figsize=(12, 9.4 if pictured else 4.6), facecolor="white")
    rows = [1.55, 1] if pictured else [1]
    grid = figure.add_gridspec(len(rows), 3, height_ratios=rows, width_ratios=[1.5, 1, 1], hspace=0.12, wspace=0.3)
    grid.update(left=0.06, right=0.98, top=0.92 if pictured else 0.86, bottom=0.08 if pictured else 0.14)
    sigma = f"{found['sigma'] * 1e3:.2g}"
    title = f"{found['beads']} beads in {found['frames']} pairs of images: {found['seen']:.1%} seen, standard deviation {sigma} mm"
    figure.suptitle(title, x=0.02, ha="left", fontsize=14, fontweight="bold")
    if found["warnings"]:
        figure.text(
            0.02, 0.935 if pictured else 0.89, f"{len(found['warnings'])} warning(s): see summary.txt", color=_ORANGE
        )
    if rest is not None:
        _images(figure.add_subplot(grid[0, :]), rest)
    _presence(figure.add_subplot(grid[-1, 0]), data)
    _deviations(figure.add_subplot(grid[-1, 1]), data)
    _agreement(figure.add_subplot(grid[-1, 2]), data)
    return figure


def _images(axes: Axes, rest: Pixels) -> None:
    axes.imshow(rest[_LINE:])
    axes.set_axis_off()
    axes.set_title(
        "the first images, left and right: circles around the beads that were found", loc="left", fontsize=10
    )


def _presence(axes: Axes, data: xr.Dataset) -> None:
    """Which bead was seen in which frame."""
    from matplotlib.colors import ListedColormap

    seen = np.isfinite(data["position"].values).all(axis=2)
    axes.imshow(
        seen.T, aspect="auto", cmap=ListedColormap([_ORANGE, "#DCE9F2"]), vmin=0, vmax=1, interpolation="nearest"
    )
    names = [str(name) for name in data["fiducial"].values]
    axes.set_yticks(range(len(names)), names, fontsize=7)
    for begin in np.flatnonzero(data["step"].values == 0)[1:]:
        axes.axvline(begin - 0.5, color="black", linewidth=0.8)
    axes.set_xlabel("pair of images")
    axes.set_ylabel("bead")
    axes.set_title("gaps (orange)", loc="left", fontsize=10)


def _deviations(axes: Axes, data: xr.Dataset) -> None:
    """Standard deviation of the positions, along the best and the worst direction of each."""
    covariance = data["covariance"].values.reshape(-1, 3, 3)
    covariance = covariance[np.isfinite(covariance).all(axis=(1, 2))]
    sizes = np.sqrt(np.linalg.eigvalsh(covariance)) * 1e3
    bins = list(np.linspace(0, np.quantile(sizes[:, 2], 0.98) * 1.1 + 1e-9, 40))
    axes.hist(sizes[:, 0], bins=bins, color=_BLUE, label="best direction")
    axes.hist(sizes[:, 2], bins=bins, histtype="step", color=_ORANGE, linewidth=2, label="worst (depth)")
    axes.set_xlabel("standard deviation, mm")
    axes.set_ylabel("positions")
    axes.legend(frameon=False, fontsize=9)
    open_frame(axes)


def _agreement(axes: Axes, data: xr.Dataset) -> None:
    """Misfit of the two cameras against what its chi-square distribution has."""
    from scipy.stats import chi2

    misfit = np.sort(data["misfit"].values[np.isfinite(data["misfit"].values)])
    share = (np.arange(len(misfit)) + 0.5) / max(len(misfit), 1)
    axes.plot(np.sqrt(misfit), share, color=_BLUE, linewidth=2, label="found")
    x = np.linspace(0, 4, 200)
    axes.plot(x, chi2.cdf(x**2, 1), color=_GREY, linewidth=2, linestyle="--", label="expected")
    axes.set_xlim(0, max(4, float(np.sqrt(misfit[int(0.98 * (len(misfit) - 1))])) if len(misfit) else 4))
    axes.set_xlabel("distance of the rays, st. dev.")
    axes.set_ylabel("share of positions")
    axes.legend(frameon=False, fontsize=9)
    open_frame(axes)
