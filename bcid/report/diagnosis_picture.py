"""What `bcid compare`, `diagnose`, `fit` and `explain` show: what the model misses, the force that would explain it, and the
falling error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.base.tails import chi2_tail
from bcid.base.units import force_unit, percent, uncertain, unit_factor
from bcid.report.figure import COLOURS, MAP, Image, body_entries, completed, cropped, head, round_length
from bcid.report.scene3d import BodyPicture
from bcid.report.text import conclusion, model_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_SIZE = (1500, 1250)
# The longest arrow is drawn as this part of the body's diagonal, or a little shorter.
LONGEST = 0.22
# Of more markers arrows would hide each other, and what the models miss is a map.
_ARROWS = 64
# A force is drawn when chance makes one as large on any region with less than this probability.
_CHANCE = 0.05
# A force that explains a smaller share of what is beyond noise is none.
_NOTHING = 0.1


# -- what the models miss
# ----------------------------------------------------------------------------------------------------------


def residual_figure(found: dict[str, Any], body: xr.Dataset, residuals: xr.Dataset) -> Figure:
    """The residual of the first model as arrows, of a dense field as a map, beside that of the last one in the same scale."""
    measured, last = residuals["measured"].values * 1e3, residuals["predicted"].values * 1e3
    first = residuals["predicted_first"].values * 1e3
    frame = worst_frame(measured - first)
    length = np.linalg.norm((completed(measured, first) - first)[frame], axis=1)
    scale = round_scale(LONGEST * diagonal(body) / float(np.nanmax(length)))
    panels = [(found["ladder"][0], first)]
    if len(found["ladder"]) > 1:
        panels.append((found["ladder"][-1], last))
    shown = [(completed(measured, predicted) - predicted)[frame] for _, predicted in panels]
    most = max(float(np.nanmax(np.linalg.norm(missed, axis=1))) for missed in shown)
    dense, grasp = measured.shape[1] > _ARROWS, str(residuals["grasp"].values[frame])
    images = []
    for (_, predicted), missed in zip(panels, shown, strict=True):
        seen = np.isfinite(missed).all(axis=1)
        scene = BodyPicture(body, frame, _SIZE)
        scene.add_body(found["anchored"], grasp)
        if dense:
            scene.add_field(predicted[frame][seen], np.linalg.norm(missed[seen], axis=1), most)
        else:
            scene.add_arrows(predicted[frame][seen], scale * missed[seen])
        images.append(scene.image())
    unit = found["length_unit"]
    titles = [f"{model_name(rung['model'])}: {rung['rms']:.3g} {unit}" for rung, _ in panels]
    figure = _panels(images, titles)
    what = "What the model misses" if len(panels) == 1 else "What the models miss"
    head(
        figure,
        f"{body.attrs.get('scene', 'body')}: {conclusion(found)}",
        f"{what}: residual per coordinate (RMS), noise {found['noise_rms']:.3g} {unit}",
    )
    where = f"action {residuals['action'].values[frame]}, step {int(residuals['step'].values[frame])}"
    arrow = "" if dense else f"measured − predicted, {scale:g} × as long as it is ({where})"
    _legend(figure, arrow, grasp, body)
    if dense:
        _colour_bar(figure, most, f"|measured − predicted|, mm\n({where})")
    return figure


def worst_frame(residual: Array) -> int:
    """The frame with the largest residual."""
    square = np.full(len(residual), -1.0)
    seen = np.isfinite(residual).any(axis=(1, 2))
    square[seen] = np.nanmean(residual[seen] ** 2, axis=(1, 2))
    return int(square.argmax())


def round_scale(scale: float) -> float:
    """The largest of 1, 2, 5, 10, ... that is not larger."""
    return round_length(scale) if np.isfinite(scale) and scale > 0 else 1.0


def diagonal(body: xr.Dataset) -> float:
    """Of the body's bounding box at rest, mm."""
    return float(np.linalg.norm(np.ptp(body["points"].values, axis=0))) * 1e3


# -- the missing force
# -------------------------------------------------------------------------------------------------------------


def where_figure(found: dict[str, Any], where: dict[str, Any], body: xr.Dataset, residuals: xr.Dataset) -> Figure:
    """The force that would explain the residual: its steady part, and the largest of those that grow in an action.

    Only forces that chance does not make are drawn, each with its size and its standard error: those on regions, or where no
    region tells its own their sum, in the middle of the body.
    """
    to_mm = unit_factor(where["length_unit"], "m") * 1e3
    parts = _parts(where)
    tries = sum(len(part.regions) + 1 for part in parts.values())
    told = {action: part.told(tries) for action, part in parts.items()} if where["explained"] >= _NOTHING else {}
    growing = max((action for action in told if action), key=lambda action: _strength(told[action]), default="")
    shown = {action: told[action] for action in dict.fromkeys(("", growing)) if told.get(action)}
    largest = max((_size(place) for places in shown.values() for place in places), default=1.0)
    scale = LONGEST * diagonal(body) / largest
    per_newton, newtons = force_unit(largest)
    images, titles = [], []
    for action, places in (shown or {"": []}).items():
        starts, forces = (np.array([p[what] for p in places]).reshape(-1, 3) for what in ("position", "force"))
        texts = [uncertain(per_newton * _size(p), per_newton * p["stderr"]) for p in places]
        scene = BodyPicture(body, None, _SIZE)
        scene.add_body(found["anchored"], _grasp(residuals, action))
        scene.add_arrows(to_mm * starts, scale * forces, texts)
        images.append(scene.image())
        titles.append(parts[action].said(action, places, per_newton, newtons) if shown else "")
    figure = _panels(images, titles)
    first = found["ladder"][-1 if found["adequate"] is False else 0]
    model = model_name(first["model"])
    promised = (
        f"{percent(where['explained'])} of what is beyond noise, and leave {where['rms']:.3g} {where['length_unit']}"
    )
    if where["explained"] < _NOTHING:
        head(
            figure,
            "No missing force can be told",
            f"The {model} model leaves nothing beyond noise that a force on the body explains",
        )
    elif not shown:
        head(
            figure,
            "A force is missing; where it acts cannot be told",
            f"Spread over the body it would explain {promised}",
        )
    else:
        head(
            figure,
            f"The force that the {model} model lacks",
            f"It would explain {promised} (its size is right if the stiffness is)",
        )
    where_drawn = (
        "force on a region" if any(place in parts[a].regions for a in shown for place in shown[a]) else "force"
    )
    _legend(figure, f"{where_drawn}, {newtons} ± standard error" if shown else "", "", body)
    return figure


@dataclass(frozen=True)
class _Part:
    """A missing force that acts at some time: on each region, and in all (an older run folder does not say it)."""

    regions: list[dict[str, Any]]
    whole: dict[str, Any] | None

    def told(self, tries: int) -> list[dict[str, Any]]:
        """The forces on regions that can be told, or their sum where that can be told alone."""
        regions = [place for place in self.regions if _told(place, tries)]
        if not regions and self.whole and _told(self.whole, tries):
            return [self.whole]
        return regions

    def said(self, action: str, told: list[dict[str, Any]], per_newton: float, newtons: str) -> str:
        """When the force acts, what it is together (as `force_unit` has it), and on how many of the regions it can be told."""
        when = f"growing in action {action}" if action else "in all frames"
        sums = self.whole["force"] if self.whole else np.sum([p["force"] for p in self.regions], axis=0)
        together = " ".join(f"{per_newton * v:+.3g}" for v in sums).replace("-", "−")
        number = len([place for place in told if place in self.regions])
        on = f"{number} of {len(self.regions)} regions" if number else "no single region"
        return f"{when}: together ({together}) {newtons},\ntold on {on}"


def _parts(where: dict[str, Any]) -> dict[str, _Part]:
    """The missing force in all frames ("") and in each action."""
    together = where.get("together", {"growing": {}})
    growing = {action: _Part(places, together["growing"].get(action)) for action, places in where["growing"].items()}
    return {"": _Part(where["steady"], together.get("steady")), **growing}


def _told(place: dict[str, Any], tries: int) -> bool:
    """Whether chance would not make so large a force on any of so many regions (Bonferroni)."""
    ratio = _size(place) / max(place["stderr"], 1e-300)
    return bool(chi2_tail(min(ratio, 1e6) ** 2, 3) * tries < _CHANCE)


def _size(place: dict[str, Any]) -> float:
    return float(np.linalg.norm(place["force"]))


def _strength(places: list[dict[str, Any]]) -> float:
    """How far forces exceed what can be told from none, in units of their errors."""
    return sum((_size(p) / max(p["stderr"], 1e-300)) ** 2 for p in places)


def _grasp(residuals: xr.Dataset, action: str) -> str:
    names = residuals["grasp"].values[residuals["action"].values == action]
    return str(names[-1]) if len(names) else ""


# -- what figures share
# ------------------------------------------------------------------------------------------------------------


def _panels(images: list[Image], titles: list[str]) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2 * len(images) if len(images) > 1 else 9.5, 7.4), facecolor="white")
    grid = figure.add_gridspec(1, len(images), wspace=0.03)
    lines = max(title.count("\n") for title in titles)
    grid.update(left=0.015, right=0.985, top=0.815 - 0.032 * lines, bottom=0.085)
    for i, (image, title) in enumerate(zip(cropped(images), titles, strict=True)):
        axes = figure.add_subplot(grid[0, i])
        axes.imshow(image)
        axes.set_axis_off()
        axes.set_title(title, fontsize=13.5, pad=8)
    return figure


def _colour_bar(figure: Figure, most: float, label: str) -> None:
    """At the right of the pictures, which make room for it."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    for axes in figure.axes:
        place = axes.get_position()
        axes.set_position((0.9 * place.x0, place.y0, 0.9 * place.width, place.height))
    axes = figure.add_axes((0.925, 0.22, 0.014, 0.45))
    bar = figure.colorbar(ScalarMappable(Normalize(0.0, most), MAP), cax=axes)
    bar.outline.set_visible(False)
    axes.set_title(label, fontsize=11, loc="right", pad=12)


def _legend(figure: Figure, arrow: str, grasp: str, body: xr.Dataset) -> None:
    from matplotlib.lines import Line2D

    arrows = [Line2D([], [], color=COLOURS.predicted, linewidth=3, label=arrow)] if arrow else []
    narrow = figure.get_figwidth() < 10
    handles = [*arrows, *body_entries(grasp, body)]
    figure.legend(handles=handles, loc="lower center", frameon=False, fontsize=11, ncols=2 if narrow else 4)
