"""The falling error: the models in turn, and the ranked effects with the error now, expected and fitted."""

from __future__ import annotations

import textwrap
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bcid.report.figure import COLOURS, DARK, GREY, LIGHT, chart, head, short
from bcid.report.text import conclusion, falling, steps_of
from bcid.results.diagnosis_record import DiagnosisRecord, RankedEffect
from bcid.results.words import model_name, plain

_ROWS = 10


def models_figure(found: DiagnosisRecord) -> Figure:
    """Both charts in one picture, below the verdict."""
    rows = found.ranking[:_ROWS]
    figure = Figure(figsize=(14, 6.6) if rows else (8, 6.6), facecolor="white")
    grid = figure.add_gridspec(1, 2 if rows else 1, width_ratios=[1, 1.15] if rows else [1], wspace=0.42)
    grid.update(left=0.135 if rows else 0.24, right=0.975, top=0.77, bottom=0.17)
    title = conclusion(found)
    head(figure, title[:1].upper() + title[1:], falling(found) if len(found.model_sequence) < 5 else "")
    bars = figure.add_subplot(grid[0, 0])
    draw_models(bars, found)
    _titled(bars, "Error of the models (RMS, mm)", 0.35, 3)
    if rows:
        ranked = figure.add_subplot(grid[0, 1])
        draw_ranking(ranked, found)
        asked = model_name(found.first_inadequate.model)
        _titled(ranked, f"Error of {asked} with one effect more (RMS, mm)", 0.45, 4)
    return figure


def _titled(axes: Axes, title: str, place: float, columns: int) -> None:
    axes.set_xlabel("")
    axes.tick_params(axis="y", labelsize=11)
    axes.set_title(title, fontsize=13, loc="left", pad=12)
    axes.legend(fontsize=10.5, loc="upper center", bbox_to_anchor=(place, -0.12), ncols=columns, columnspacing=1.2)


def models_chart(found: DiagnosisRecord) -> Figure:
    """The error of each model as bars."""
    return chart(lambda axes: draw_models(axes, found), 1.7 + 0.62 * max(2, len(found.model_sequence)))


def ranking_chart(found: DiagnosisRecord) -> Figure:
    """What each effect alone would make of the error."""
    return chart(lambda axes: draw_ranking(axes, found), 1.5 + 0.3 * max(4, len(found.ranking[:_ROWS])))


def draw_models(axes: Axes, found: DiagnosisRecord) -> None:
    """Bars of the error of each model, all actions fitted and each predicted from the others, beside the noise."""
    steps = steps_of(found.model_sequence)
    high = 0.36
    series = [("rms", DARK, "", "fitted", -high / 2), ("held_out_rms", LIGHT, "///", "held out", high / 2)]
    largest = found.noise_rms
    for key, colour, hatch, label, aside in series:
        known = [(i, getattr(model, key)) for i, (_, model) in enumerate(steps) if getattr(model, key) is not None]
        if not known:
            continue
        places, values = [i + aside for i, _ in known], [value for _, value in known]
        bars = axes.barh(places, values, height=high, color=colour, hatch=hatch, edgecolor="white", label=label)
        axes.bar_label(bars, [f"{value:.3g}" for value in values], padding=4, color=GREY)
        largest = max(largest, *values)
    axes.axvline(found.noise_rms, color="black", linewidth=1.4, linestyle="--", label="noise")
    names = ["\n".join(textwrap.wrap(name, 18, max_lines=3)) for name, _ in steps]
    axes.set_yticks(range(len(steps)), names)
    # One model alone gets no bars as thick as the picture.
    axes.set_ylim(max(len(steps), 2) - 0.4, -0.6)
    axes.set_xlim(0, 1.17 * largest)
    axes.set_xlabel("RMS residual per coordinate (mm)")


def draw_ranking(axes: Axes, found: DiagnosisRecord) -> None:
    """For each effect a line from the error now to the error expected, and the error that fitting it left."""
    rows = found.ranking[:_ROWS]
    now, noise = found.first_inadequate.rms, found.noise_rms
    hollow: dict[str, Any] = {
        "markersize": 8,
        "markerfacecolor": "white",
        "markeredgecolor": GREY,
        "markeredgewidth": 1.6,
    }
    for i, row in enumerate(rows):
        axes.plot([now, row.expected_rms], [i, i], color="#b9bec6", linewidth=1.5, zorder=1)
        axes.plot(row.expected_rms, i, "o", label="expected" if i == 0 else None, **hollow)
    fitted = [(row.fitted_rms, i) for i, row in enumerate(rows) if row.fitted_rms is not None]
    if fitted:
        axes.plot(*zip(*fitted, strict=True), "D", markersize=7, color=COLOURS.predicted, label="fitted", zorder=3)
    axes.axvline(now, color=GREY, linewidth=1.4, label="now")
    axes.axvline(noise, color="black", linewidth=1.4, linestyle="--", label="noise")
    axes.set_yticks(range(len(rows)), [short(place_name(row)) for row in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    values = [now, noise, *(row.expected_rms for row in rows), *(row.fitted_rms or 0 for row in rows)]
    axes.set_xlim(0, 1.06 * max(values))
    axes.set_xlabel("RMS residual per coordinate (mm)")
    axes.grid(axis="y", color="#eeeeee", linewidth=1)
    axes.set_axisbelow(True)


def place_name(row: RankedEffect) -> str:
    """An effect with its place: "soft anchor (3)"."""
    return plain(row.effect) + (f" ({row.place})" if row.place else "")
