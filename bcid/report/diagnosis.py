"""What `bcid compare`, `diagnose`, `fit` and `explain` show: what the model misses, the force that would explain it, and the
falling error.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.report.figure import body_entries, cropped, open_frame, save
from bcid.report.paraview import write_paraview
from bcid.report.scene3d import COLOURS, Image, arrows_picture
from bcid.run import Run, writing
from bcid.units import percent, unit_factor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_SIZE = (1500, 1250)
# The longest arrow is drawn as this part of the body's diagonal, or a little shorter.
_LONGEST = 0.22
# A force is told from none beyond so many standard errors.
_TOLD = 2.0
# A force that explains a smaller share of what is beyond noise is none.
_NOTHING = 0.1
_ROWS = 10
_DARK, _LIGHT = "#0072b2", "#9ccbe8"
_GREY = "#444444"


def draw(folder: str | Path) -> list[Path]:
    """Draw the pictures of a finished comparison and write `paraview/`; returns what was written.

    `where.png` needs `where.json`, which is not there when nothing is missing.
    """
    run = Run.open(folder)
    found = run.read_json("diagnosis.json")
    body, residuals = run.read_dataset("body.nc"), run.read_dataset("residuals.nc")
    figures = {"picture.png": residual_figure(found, body, residuals), "ladder.png": ladder_figure(found)}
    if (run.path / "where.json").is_file():
        figures["where.png"] = where_figure(found, run.read_json("where.json"), body, residuals)
    with writing(run.path):
        written = [save(figure, run.path / name) for name, figure in figures.items()]
        return [*written, write_paraview(run.path / "paraview", body, residuals)]


def falling(found: dict[str, Any]) -> str:
    """The ladder in one line: "neo-Hookean 1.42 mm → + gravity 0.205 mm (noise 0.2)"."""
    steps = [f"{text} {rung['rms']:.3g} {found['length_unit']}" for text, rung in _steps(found)]
    return f"{' → '.join(steps)} (noise {found['noise_rms']:.3g})"


def conclusion(found: dict[str, Any]) -> str:
    """The verdict in a few words, for a title."""
    if found["verdict"] == "unknown":
        return "none of the known effects explains it" if found["ranking"] else "the model is not adequate"
    if found["verdict"] == "none":
        return "the plain model is adequate"
    effects = " and ".join(plain(name) for name in found["verdict"].split("+"))
    return f"adequate with {effects}" if found["adequate"] else f"missing: {effects}"


def plain(name: str) -> str:
    """A name of a law or an effect as it is read: "neo-Hookean", "soft anchor (3)"."""
    return {"neo_hooke": "neo-Hookean"}.get(name, name.replace("_", " ").replace("(", " ("))


def _steps(found: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Each model of the ladder, named by what it has beyond the one before, else by all it has."""
    steps, before = [], ""
    for rung in found["ladder"]:
        model = rung["model"]
        more = model.removeprefix(f"{before} + ") if before and model.startswith(f"{before} + ") else ""
        text = _model(more or model)
        steps.append((f"+ {text}" if more else text, rung))
        before = model
    return steps


# -- what the models miss
# ----------------------------------------------------------------------------------------------------------


def residual_figure(found: dict[str, Any], body: xr.Dataset, residuals: xr.Dataset) -> Figure:
    """The residual of the first model as arrows, beside that of the last one in the same scale."""
    measured, last = residuals["measured"].values * 1e3, residuals["predicted"].values * 1e3
    first = residuals["predicted_first"].values * 1e3
    frame = worst_frame(measured - first)
    length = np.linalg.norm((measured - first)[frame], axis=1)
    scale = round_scale(_LONGEST * diagonal(body) / float(np.nanmax(length)))
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
    titles = [f"{_model(rung['model'])}: {rung['rms']:.3g} {unit}" for rung, _ in panels]
    figure = _panels(images, titles)
    head = "What the model misses" if len(panels) == 1 else "What the models miss"
    _head(
        figure,
        f"{body.attrs.get('scene', 'body')}: {conclusion(found)}",
        f"{head}: residual per coordinate (RMS), noise {found['noise_rms']:.3g} {unit}",
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


def _model(model: str) -> str:
    """The name of a model as it is read: "neo-Hookean + gravity"."""
    return " + ".join(plain(part) for part in model.split(" + "))


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
    scale = _LONGEST * diagonal(body) / (largest or 1.0)
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
        _head(
            figure,
            "No missing force can be told",
            f"{_model(first['model'])} leaves nothing beyond noise that a force explains",
        )
    else:
        _head(
            figure,
            f"The force that the {_model(first['model'])} model lacks",
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


# -- the falling error
# -------------------------------------------------------------------------------------------------------------


def ladder_figure(found: dict[str, Any]) -> Figure:
    """The error of each model as bars; beside them the ranked effects with the error now, expected and fitted."""
    from matplotlib.figure import Figure

    rows = found["ranking"][:_ROWS]
    figure = Figure(figsize=(14, 6.6) if rows else (8, 6.6), facecolor="white")
    grid = figure.add_gridspec(1, 2 if rows else 1, width_ratios=[1, 1.15] if rows else [1], wspace=0.42)
    grid.update(left=0.135 if rows else 0.24, right=0.975, top=0.77, bottom=0.17)
    _head(
        figure,
        conclusion(found)[:1].upper() + conclusion(found)[1:],
        falling(found) if len(found["ladder"]) < 5 else "",
    )
    _bars(figure.add_subplot(grid[0, 0]), found)
    if rows:
        _ranked(figure.add_subplot(grid[0, 1]), found, rows)
    return figure


def _bars(axes: Axes, found: dict[str, Any]) -> None:
    steps = _steps(found)
    high = 0.36
    series = [
        ("rms", _DARK, "", "all actions fitted", -high / 2),
        ("held_out_rms", _LIGHT, "///", "each predicted from the others", high / 2),
    ]
    largest = found["noise_rms"]
    for key, colour, hatch, label, aside in series:
        known = [(i, rung[key]) for i, (_, rung) in enumerate(steps) if rung[key] is not None]
        if not known:
            continue
        places, values = [i + aside for i, _ in known], [value for _, value in known]
        bars = axes.barh(places, values, height=high, color=colour, hatch=hatch, edgecolor="white", label=label)
        axes.bar_label(bars, [f"{value:.3g}" for value in values], padding=4, fontsize=11, color=_GREY)
        largest = max(largest, *values)
    axes.axvline(found["noise_rms"], color="black", linewidth=1.4, linestyle="--", label="noise")
    axes.set_yticks(range(len(steps)), [text.replace(" + ", "\n+ ") for text, _ in steps])
    # One model alone gets no bars as thick as the picture.
    axes.set_ylim(max(len(steps), 2) - 0.4, -0.6)
    axes.set_xlim(0, 1.14 * largest)
    axes.set_title(f"Error of the models (RMS, {found['length_unit']})", fontsize=13, loc="left", pad=12)
    axes.legend(
        frameon=False, fontsize=10.5, loc="upper center", bbox_to_anchor=(0.35, -0.12), ncols=3, columnspacing=1.2
    )
    _bare(axes)


def _ranked(axes: Axes, found: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    asked = next((rung for rung in found["ladder"] if not rung["adequate"]), found["ladder"][0])
    now, noise = asked["rms"], found["noise_rms"]
    for i, row in enumerate(rows):
        axes.plot([now, row["expected_rms"]], [i, i], color="#b9bec6", linewidth=1.5, zorder=1)
        axes.plot(
            row["expected_rms"],
            i,
            "o",
            markersize=9,
            markerfacecolor="white",
            markeredgecolor=_GREY,
            markeredgewidth=1.6,
        )
        if row["fitted_rms"] is not None:
            axes.plot(row["fitted_rms"], i, "D", markersize=8, color=COLOURS.predicted, zorder=3)
    axes.plot(
        [],
        [],
        "o",
        markersize=9,
        markerfacecolor="white",
        markeredgecolor=_GREY,
        markeredgewidth=1.6,
        linestyle="",
        label="expected before any fit",
    )
    if any(row["fitted_rms"] is not None for row in rows):
        axes.plot([], [], "D", markersize=8, color=COLOURS.predicted, linestyle="", label="fitted")
    axes.axvline(now, color=_GREY, linewidth=1.4, label="now")
    axes.axvline(noise, color="black", linewidth=1.4, linestyle="--", label="noise")
    axes.set_yticks(range(len(rows)), [_place(row) for row in rows], fontsize=11.5)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    values = [now, noise, *(row["expected_rms"] for row in rows), *(row["fitted_rms"] or 0 for row in rows)]
    axes.set_xlim(0, 1.06 * max(values))
    axes.set_title(
        f"Error of {_model(asked['model'])} with one effect more (RMS, {found['length_unit']})",
        fontsize=13,
        loc="left",
        pad=12,
    )
    axes.legend(
        frameon=False, fontsize=10.5, loc="upper center", bbox_to_anchor=(0.45, -0.12), ncols=4, columnspacing=1.2
    )
    _bare(axes)
    axes.grid(axis="y", color="#eeeeee", linewidth=1)
    axes.set_axisbelow(True)


def _place(row: dict[str, Any]) -> str:
    return plain(row["effect"]) + (f" ({row['place']})" if row["place"] else "")


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


def _head(figure: Figure, title: str, text: str) -> None:
    inches = figure.get_figwidth()
    figure.text(0.28 / inches, 0.935, title, fontsize=19 if inches > 10 else 16, weight="bold")
    figure.text(0.28 / inches, 0.885, text, fontsize=12.5 if inches > 10 else 11, color=_GREY)


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


def _bare(axes: Axes) -> None:
    open_frame(axes)
    axes.tick_params(axis="y", labelsize=11)
