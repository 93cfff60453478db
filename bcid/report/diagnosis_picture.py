"""What `bcid compare`, `diagnose`, `fit` and `explain` show: what the model misses, the force that would explain it, and the
falling error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from bcid.base.tails import chi2_tail
from bcid.base.units import force_unit, percent, uncertain
from bcid.report.figure import COLOURS, MAP, Image, body_entries, completed, cropped, head, round_length
from bcid.report.scene3d import BodyPicture
from bcid.report.text import conclusion
from bcid.results.diagnosis_record import DiagnosisRecord, DiscrepancyRecord, ForceRow
from bcid.results.words import model_name

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


def residual_figure(found: DiagnosisRecord, body: xr.Dataset, residuals: xr.Dataset) -> Figure:
    """The residual of the first model as arrows, of a dense field as a map, beside that of the last one in the same scale."""
    measured, last = residuals["measured"].values * 1e3, residuals["predicted"].values * 1e3
    first = residuals["predicted_first"].values * 1e3
    frame = worst_frame(measured - first)
    length = np.linalg.norm((completed(measured, first) - first)[frame], axis=1)
    scale = round_length(LONGEST * diagonal(body) / float(np.nanmax(length)))
    panels = [(found.model_sequence[0], first)]
    if len(found.model_sequence) > 1:
        panels.append((found.model_sequence[-1], last))
    shown = [(completed(measured, predicted) - predicted)[frame] for _, predicted in panels]
    most = max(float(np.nanmax(np.linalg.norm(missed, axis=1))) for missed in shown)
    dense, grasp = measured.shape[1] > _ARROWS, str(residuals["grasp"].values[frame])
    images = []
    for (_, predicted), missed in zip(panels, shown, strict=True):
        seen = np.isfinite(missed).all(axis=1)
        scene = BodyPicture(body, frame, _SIZE)
        scene.add_body(found.anchored, grasp)
        if dense:
            scene.add_field(predicted[frame][seen], np.linalg.norm(missed[seen], axis=1), most)
        else:
            scene.add_arrows(predicted[frame][seen], scale * missed[seen])
        images.append(scene.image())
    titles = [f"{model_name(rung.model)}: {rung.rms:.3g} mm" for rung, _ in panels]
    figure = _panels(images, titles)
    what = "What the model misses" if len(panels) == 1 else "What the models miss"
    text = f"{what}: residual per coordinate (RMS), noise {found.noise_rms:.3g} mm"
    head(figure, f"{body.attrs.get('scene', 'body')}: {conclusion(found)}", text)
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


def diagonal(body: xr.Dataset) -> float:
    """Of the body's bounding box at rest, mm."""
    return float(np.linalg.norm(np.ptp(body["points"].values, axis=0))) * 1e3


# -- the missing force


@dataclass(frozen=True)
class _Force:
    """A missing force that acts in all frames (`action` ""), or grows in an action: on each region, and in all."""

    action: str
    regions: Sequence[ForceRow]
    whole: ForceRow

    def told(self, tries: int) -> list[ForceRow]:
        """The forces on regions that can be told, or their sum where that can be told alone."""
        return [p for p in self.regions if _told(p, tries)] or [p for p in (self.whole,) if _told(p, tries)]

    def title(self, told: list[ForceRow], per_newton: float, newtons: str) -> str:
        """When the force acts, what it is together (as `force_unit` has it), and on how many of the regions it can be told."""
        when = f"growing in action {self.action}" if self.action else "in all frames"
        together = " ".join(f"{per_newton * v:+.3g}" for v in self.whole.force).replace("-", "−")
        on = f"{len(told)} of {len(self.regions)} regions" if told[0] in self.regions else "no single region"
        return f"{when}: together ({together}) {newtons},\ntold on {on}"


def discrepancy_figure(
    found: DiagnosisRecord, where: DiscrepancyRecord, body: xr.Dataset, residuals: xr.Dataset
) -> Figure:
    """The force that would explain the residual: its steady part, and the largest of those that grow in an action.

    Only forces that chance does not make are drawn, each with its size and its standard error: those on regions, or where no
    region tells its own their sum, in the middle of the body.
    """
    shown = _shown(where)
    largest = max((_size(place) for _, places in shown for place in places), default=1.0)
    per_newton, newtons = force_unit(largest)
    images, titles = [], []
    panels: list[tuple[_Force | None, list[ForceRow]]] = [*shown] or [(None, [])]
    for force, places in panels:
        starts, forces = (np.array([getattr(p, what) for p in places]).reshape(-1, 3) for what in ("position", "force"))
        scene = BodyPicture(body, None, _SIZE)
        scene.add_body(found.anchored, _grasp(residuals, force.action if force else ""))
        texts = [uncertain(per_newton * _size(p), per_newton * p.stderr) for p in places]
        scene.add_arrows(starts, LONGEST * diagonal(body) / largest * forces, texts)
        images.append(scene.image())
        titles.append(force.title(places, per_newton, newtons) if force else "")
    figure = _panels(images, titles)
    model = model_name(found.model_sequence[-1 if found.adequate is False else 0].model)
    left = f"{percent(where.explained_fraction)} of what is beyond noise, and leave {where.rms:.3g} mm"
    if where.explained_fraction < _NOTHING:
        text = f"The {model} model leaves nothing beyond noise that a force on the body explains"
        head(figure, "No missing force can be told", text)
    elif not shown:
        text = f"Spread over the body it would explain {left}"
        head(figure, "A force is missing; where it acts cannot be told", text)
    else:
        text = f"It would explain {left} (its size is right if the stiffness is)"
        head(figure, f"The force that the {model} model lacks", text)
    on = " on a region" if any(places[0] in force.regions for force, places in shown) else ""
    _legend(figure, f"force{on}, {newtons} ± standard error" if shown else "", "", body)
    return figure


def _shown(where: DiscrepancyRecord) -> list[tuple[_Force, list[ForceRow]]]:
    """The steady force and the strongest of those that grow, with their parts that can be told."""
    together = where.together
    forces = [_Force("", where.steady, together.steady)]
    forces += [_Force(action, places, together.growing[action]) for action, places in where.growing.items()]
    tries = sum(len(force.regions) + 1 for force in forces)
    told = [(force, places) for force in forces if (places := force.told(tries))]
    growing = sorted((one for one in told if one[0].action), key=lambda one: -_strength(one[1]))
    return [*(one for one in told if not one[0].action), *growing[:1]] if where.explained_fraction >= _NOTHING else []


def _told(place: ForceRow, tries: int) -> bool:
    """Whether chance would not make so large a force on any of so many regions (Bonferroni)."""
    ratio = _size(place) / max(place.stderr, 1e-300)
    return bool(chi2_tail(min(ratio, 1e6) ** 2, 3) * tries < _CHANCE)


def _size(place: ForceRow) -> float:
    return float(np.linalg.norm(place.force))


def _strength(places: list[ForceRow]) -> float:
    """How far forces exceed what can be told from none, in units of their errors."""
    return sum((_size(p) / max(p.stderr, 1e-300)) ** 2 for p in places)


def _grasp(residuals: xr.Dataset, action: str) -> str:
    names = residuals["grasp"].values[residuals["action"].values == action]
    return str(names[-1]) if len(names) else ""


# -- what figures share


def _panels(images: list[Image], titles: list[str]) -> Figure:
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
    for axes in figure.axes:
        place = axes.get_position()
        axes.set_position((0.9 * place.x0, place.y0, 0.9 * place.width, place.height))
    axes = figure.add_axes((0.925, 0.22, 0.014, 0.45))
    bar = figure.colorbar(ScalarMappable(Normalize(0.0, most), MAP), cax=axes)
    bar.outline.set_visible(False)
    axes.set_title(label, fontsize=11, loc="right", pad=12)


def _legend(figure: Figure, arrow: str, grasp: str, body: xr.Dataset) -> None:
    arrows = [Line2D([], [], color=COLOURS.predicted, linewidth=3, label=arrow)] if arrow else []
    narrow = figure.get_figwidth() < 10
    handles = [*arrows, *body_entries(grasp, body)]
    figure.legend(handles=handles, loc="lower center", frameon=False, fontsize=11, ncols=2 if narrow else 4)
