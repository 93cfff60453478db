"""What `bcid identify` shows: one picture of the result, and the same fields for ParaView."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bcid.base.units import percent
from bcid.report.figure import COLOURS, body_entries, cropped, head, name_ticks
from bcid.report.residual import rms
from bcid.report.scene3d import BodyPicture
from bcid.results.identification_record import IdentificationRecord


def summary_figure(found: IdentificationRecord, body: xr.Dataset, prediction: xr.Dataset) -> Figure:
    """The body with its anchors and trajectories; probabilities; the residual against the noise."""
    figure = Figure(figsize=(14, 7.6), facecolor="white")
    grid = figure.add_gridspec(2, 2, width_ratios=[2.15, 1], height_ratios=[1, 1], hspace=0.42, wspace=0.12)
    grid.update(left=0.015, right=0.975, top=0.85, bottom=0.1)
    names = " ".join(found.anchored) or "none"
    noise = "" if found.noise_rms is None else f", noise {found.noise_rms:.2g} mm"
    text = f"probability {percent(found.probability)}   ·   residual {found.rms:.3g} mm per coordinate{noise}"
    head(figure, f"{body.attrs.get('scene', 'body')}: anchored patches {{{names}}}", text)
    _draw_body(figure.add_subplot(grid[:, 0]), found, body, prediction)
    right = figure.add_subplot(grid[0, 1])
    draw_probabilities(right, found)
    right.set_ylabel("")
    right.set_title("Probability that a patch is anchored", fontsize=12, loc="left")
    _draw_residuals(figure.add_subplot(grid[1, 1]), found, prediction)
    return figure


def body_figure(found: IdentificationRecord, body: xr.Dataset, prediction: xr.Dataset) -> Figure:
    """The body with its anchors and trajectories alone."""
    figure = Figure(figsize=(9.5, 7.4), facecolor="white")
    _draw_body(figure.add_axes((0.015, 0.12, 0.97, 0.84)), found, body, prediction)
    return figure


def _draw_body(axes: Axes, found: IdentificationRecord, body: xr.Dataset, prediction: xr.Dataset) -> None:
    frame = telling_frame(prediction)
    grasp = str(prediction["grasp"].values[frame])
    scene = BodyPicture(body, frame, (1800, 1500))
    scene.add_body(found.anchored, grasp, 0.5)
    scene.add_trajectories(prediction)
    axes.imshow(cropped([scene.image()])[0])
    axes.set_axis_off()
    entries = [
        *body_entries(grasp, body),
        Line2D([], [], color=COLOURS.measured, marker="o", linestyle="", markersize=5, label="measured positions"),
        Line2D([], [], color=COLOURS.predicted, linewidth=3, label="predicted paths"),
        Line2D([], [], color=COLOURS.outline, linewidth=1.5, label="rest shape"),
    ]
    shown = f"shown: action {prediction['action'].values[frame]}, step {int(prediction['step'].values[frame])}"
    axes.text(0.01, 1.0, shown, transform=axes.transAxes, fontsize=10.5, color="#666666")
    axes.legend(handles=entries, loc="upper center", bbox_to_anchor=(0.5, 0.02), frameon=False, fontsize=11, ncols=3)


def telling_frame(prediction: xr.Dataset) -> int:
    """The frame in which the fiducials have moved furthest from rest."""
    away = np.linalg.norm(prediction["predicted"].values - prediction["rest"].values, axis=-1)
    return int(np.nanargmax(np.nanmean(away, axis=1)))


def draw_probabilities(axes: Axes, found: IdentificationRecord) -> None:
    """Bars of the patches' probabilities; those of the reported set are dark, the others hatched."""
    names = list(found.patches)
    values = np.array([found.patches[name] for name in names], dtype=float)
    held = np.array([name in found.anchored for name in names], dtype=bool)
    places = np.arange(len(names))
    styles: tuple[dict[str, Any], ...] = ({"color": COLOURS.anchored}, {"color": COLOURS.free, "hatch": "///"})
    for chosen, style in zip((held, ~held), styles, strict=True):
        axes.bar(places[chosen], np.maximum(values[chosen], 0.004), width=0.72, edgecolor="white", **style)
    name_ticks(axes, names)
    axes.set_xlim(-0.6, max(len(names), 3) - 0.4)
    axes.set_ylim(0, 1.03)
    axes.set_yticks([0, 0.5, 1])
    axes.set_xlabel("patch")
    axes.set_ylabel("probability of being anchored")


def _draw_residuals(axes: Axes, found: IdentificationRecord, prediction: xr.Dataset) -> None:
    """By frame, actions apart, beside the noise."""
    noise = found.noise_rms
    left = (prediction["predicted"] - prediction["measured"]).values * 1e3
    values, actions = np.array([rms(frame) for frame in left]), prediction["action"].values
    for name in dict.fromkeys(actions):
        own = np.flatnonzero(actions == name)
        axes.plot(own, values[own], color=COLOURS.predicted, linewidth=2)
    if noise is not None:
        axes.axhline(noise, color="#555555", linewidth=1.2, linestyle="--")
        style: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "ha": "right"}
        axes.annotate("noise", (1.0, noise), xytext=(-2, 3), fontsize=10, color="#555555", **style)
    axes.set_ylim(0, 1.25 * max(np.nanmax(values), noise or 0.0))
    axes.set_title("Residual per coordinate (RMS, mm)", fontsize=12, loc="left")
    axes.set_xlabel("frame" if len(set(actions)) > 1 else "step", fontsize=10.5)
