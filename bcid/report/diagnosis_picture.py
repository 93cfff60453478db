"""What `bcid compare`, `diagnose`, `fit` and `explain` show: what the model misses, the force that would explain it, and the
falling error.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.base.run_folder import RunFolder, writing
from bcid.base.units import percent, unit_factor
from bcid.report.figure import body_entries, cropped, save, styled
from bcid.report.ladder import head, ladder_figure
from bcid.report.lengths import in_mm
from bcid.report.paraview import write_paraview
from bcid.report.scene3d import COLOURS, Image, arrows_picture
from bcid.report.text import conclusion, model_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_SIZE = (1500, 1250)
# The longest arrow is drawn as this part of the body's diagonal, or a little shorter.
LONGEST = 0.22
# A force is told from none beyond so many standard errors.
_TOLD = 2.0
# A force that explains a smaller share of what is beyond noise is none.
_NOTHING = 0.1


def draw(folder: str | Path) -> list[Path]:
    """Draw the pictures of a finished comparison and write `paraview/`; returns what was written.

    `where.png` needs `where.json`, which is not there when nothing is missing.
    """
    run = RunFolder.open(folder)
    found = in_mm(run.read_json("diagnosis.json"))
    body, residuals = run.read_dataset("body.nc"), run.read_dataset("residuals.nc")
    with styled(), writing(run.path):
        figures = {"picture.png": residual_figure(found, body, residuals), "ladder.png": ladder_figure(found)}
        if (run.path / "where.json").is_file():
            figures["where.png"] = where_figure(found, in_mm(run.read_json("where.json")), body, residuals)
        written = [save(figure, run.path / name) for name, figure in figures.items()]
        return [*written, write_paraview(run.path / "paraview", body, residuals, found["anchored"])]


# -- what the models miss
# ----------------------------------------------------------------------------------------------------------


def residual_figure(found: dict[str, Any], body: xr.Dataset, residuals: xr.Dataset) -> Figure:
    """The residual of the first model as arrows, beside that of the last one in the same scale."""
    measured, last = residuals["measured"].values * 1e3, residuals["predicted"].values * 1e3
    first = residuals["predicted_first"].values * 1e3
    frame = worst_frame(measured - first)
    length = np.linalg.norm((measured - first)[frame], axis=1)
    scale = round_scale(LONGEST * diagonal(body) / float(np.nanmax(length)))
    panels = [(found["ladder"][0], first)]
    if len(found["ladder"]) > 1:
        panels.append((found["ladder"][-1], last))
    images = []
    for _, predicted in panels:
        arrows = scale * (measured - predicted)[frame]
        seen = np.isfinite(arrows).all(axis=1) & np.isfinite(last[frame]).all(axis=1)
        view = body, found["anchored"], frame, str(residuals["grasp"].values[frame])
        coloured = np.ones(int(seen.sum()), dtype=bool)
        images.append(arrows_picture(*view, last[frame][seen], arrows[seen], coloured, _SIZE))
    unit = found["length_unit"]
    titles = [f"{model_name(rung['model'])}: {rung['rms']:.3g} {unit}" for rung, _ in panels]
    figure = _panels(images, titles)
    what = "What the model misses" if len(panels) == 1 else "What the models miss"
    head(
        figure,
        f"{body.attrs.get('scene', 'body')}: {conclusion(found)}",
        f"{what}: residual per coordinate (RMS), noise {found['noise_rms']:.3g} {unit}",
    )
    shown = f"action {residuals['action'].values[frame]}, step {int(residuals['step'].values[frame])}"
    arrow = f"measured − predicted, {scale:g} × as long as it is ({shown})"
    _legend(figure, (arrow,), str(residuals["grasp"].values[frame]))
    return figure


def worst_frame(residual: Array) -> int:
    """The frame with the largest residual."""
    square = np.full(len(residual), -1.0)
    seen = np.isfinite(residual).any(axis=(1, 2))
    square[seen] = np.nanmean(residual[seen] ** 2, axis=(1, 2))
    return int(square.argmax())


def round_scale(scale: float) -> float:
    """The largest of 1, 2, 5, 10, ... that is not larger."""
    if not np.isfinite(scale) or scale <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(scale))
    return float(power * max(step for step in (1, 2, 5) if step * power <= scale * (1 + 1e-9)))


def diagonal(body: xr.Dataset) -> float:
    """Of the body's bounding box at rest, mm."""
    return float(np.linalg.norm(np.ptp(body["points"].values, axis=0))) * 1e3


# -- the missing force
# -------------------------------------------------------------------------------------------------------------


def where_figure(found: dict[str, Any], where: dict[str, Any], body: xr.Dataset, residuals: xr.Dataset) -> Figure:
    """The force that would explain the residual: its steady part, and the largest of those that grow in an action."""
    to_mm = unit_factor(where["length_unit"], "m") * 1e3
    panels = [("", where["steady"])]
    growing: tuple[str, list[dict[str, Any]]] = max(
        where["growing"].items(), key=lambda item: _strength(item[1]), default=("", [])
    )
    if _strength(growing[1]) > 0:
        panels.append(growing)
    largest = max((_size(place) for _, places in panels for place in places), default=0.0)
    scale = LONGEST * diagonal(body) / (largest or 1.0)
    images, titles = [], []
    for action, places in panels:
        starts, forces = (np.array([p[what] for p in places]).reshape(-1, 3) for what in ("position", "force"))
        told = np.array([_size(p) > _TOLD * p["stderr"] for p in places], dtype=bool)
        view = body, found["anchored"], None, _grasp(residuals, action)
        images.append(arrows_picture(*view, to_mm * starts, scale * forces, told, _SIZE))
        together = " ".join(f"{v:+.3g}" for v in 1e3 * forces.sum(axis=0))
        titles.append(f"{f'growing in action {action}' if action else 'in all frames'}: together ({together}) mN")
    figure = _panels(images, titles)
    first = found["ladder"][0 if found["adequate"] else -1]
    left = f"{where['rms']:.3g} {where['length_unit']}"
    text = f"It would explain {percent(where['explained'])} of what is beyond noise, and leave {left}"
    if where["explained"] < _NOTHING:
        head(
            figure,
            "No missing force can be told",
            f"{model_name(first['model'])} leaves nothing beyond noise that a force explains",
        )
    else:
        head(
            figure,
            f"The force that the {model_name(first['model'])} model lacks",
            f"{text} (its size is right if the stiffness is)",
        )
    _legend(
        figure,
        (f"force on a region, beyond twice its error (longest arrow {1e3 * largest:.2g} mN)", "within twice its error"),
        "",
    )
    return figure


def _size(place: dict[str, Any]) -> float:
    return float(np.linalg.norm(place["force"]))


def _strength(places: list[dict[str, Any]]) -> float:
    """How far forces exceed what can be told from none, in units of their errors."""
    return sum(max((_size(p) / max(p["stderr"], 1e-300)) ** 2 - _TOLD**2, 0.0) for p in places)


def _grasp(residuals: xr.Dataset, action: str) -> str:
    names = residuals["grasp"].values[residuals["action"].values == action]
    return str(names[-1]) if len(names) else ""


# -- what figures share
# ------------------------------------------------------------------------------------------------------------


def _panels(images: list[Image], titles: list[str]) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2 * len(images) if len(images) > 1 else 9.5, 7.4), facecolor="white")
    grid = figure.add_gridspec(1, len(images), wspace=0.03)
    grid.update(left=0.015, right=0.985, top=0.815, bottom=0.085)
    for i, (image, title) in enumerate(zip(cropped(images), titles, strict=True)):
        axes = figure.add_subplot(grid[0, i])
        axes.imshow(image)
        axes.set_axis_off()
        axes.set_title(title, fontsize=13.5, pad=8)
    return figure


def _legend(figure: Figure, arrows: tuple[str, ...], grasp: str) -> None:
    from matplotlib.lines import Line2D

    entries = [
        *(
            Line2D([], [], color=colour, linewidth=width, label=text)
            for text, colour, width in zip(arrows, (COLOURS.predicted, COLOURS.weak), (3, 2), strict=False)
        ),
        *body_entries(grasp),
    ]
    narrow = figure.get_figwidth() < 10
    figure.legend(handles=entries, loc="lower center", frameon=False, fontsize=11, ncols=2 if narrow else 4)
