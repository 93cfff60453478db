"""The pictures of the hidden study: rates beside goals, how often told answers are right, how rates fall with size and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import PercentFormatter

from validation.plots import STYLE

_DARK, _GOAL = "#0072B2", "#D55E00"
_PERCENT = PercentFormatter(1.0, decimals=0, symbol=" %")
# Okabe & Ito's colours; markers and dashes tell the lines apart in black and white.
_LINES = {
    "named": ("#0072B2", "o", "-"),
    "first two": ("#56B4E9", "s", "--"),
    "parameters": ("#009E73", "^", "-."),
    "not misnamed": ("#D55E00", "D", ":"),
    "anchors": ("#000000", "v", (0, (5, 1, 1, 1, 1, 1))),
}


def goals(file: Path, found: Mapping[str, Any]) -> None:
    """Rates with their 95 % intervals beside their goals, and told probabilities beside how often they were right, as PNG."""
    asked = {name: rate for name, rate in found["rates"].items() if rate["count"]}
    with plt.rc_context(STYLE):
        size = (9.4, max(3.6, 0.25 * len(asked) + 1.0))
        figure, (left, right) = plt.subplots(1, 2, figsize=size, dpi=150, layout="constrained")
        _beside_goals(left, asked)
        _told(right, found["calibration"]["bins"])
        figure.savefig(file)
        plt.close(figure)


def _beside_goals(axes: Any, asked: Mapping[str, Mapping[str, Any]]) -> None:
    """A line for each question; what misses its goal by more than chance makes of so few answers is hollow."""
    for k, rate in enumerate(asked.values()):
        missed = rate["goal"] is not None and rate["high"] < rate["goal"]
        if rate["goal"] is not None:
            axes.plot([rate["goal"], rate["most"]], [k, k], color=_GOAL, lw=7, alpha=0.35, solid_capstyle="butt")
        axes.plot([rate["low"], rate["high"]], [k, k], color=_DARK, lw=1.2)
        axes.plot(rate["rate"], k, "o", ms=6, color=_DARK, mfc="white" if missed else _DARK, clip_on=False)
    axes.plot([], [], color=_GOAL, lw=7, alpha=0.35, label="goal")
    axes.plot([], [], "o-", color=_DARK, lw=1.2, ms=6, label="reached, 95 % interval")
    axes.plot([], [], "o-", color=_DARK, lw=1.2, ms=6, mfc="white", label="... below the goal")
    axes.set_yticks(range(len(asked)), [f"{name} ({rate['count']})" for name, rate in asked.items()])
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    axes.set_xlim(-0.02, 1.0)
    axes.xaxis.set_major_formatter(_PERCENT)
    axes.set_title("right answers (of how many)")
    axes.legend(frameon=False, loc="lower left")


def _told(axes: Any, bins: Sequence[Mapping[str, Any]]) -> None:
    """How often answers were right over how probable they were told, by bins; beside each the number of answers."""
    axes.plot([0, 1], [0, 1], color=_GOAL, lw=1.2, ls="--", label="as often as told")
    for b in (b for b in bins if b["count"]):
        axes.plot([b["told"], b["told"]], [b["low"], b["high"]], color=_DARK, lw=1.2)
        axes.plot(b["told"], b["rate"], "o", ms=6, color=_DARK, clip_on=False)
        below = {"textcoords": "offset points", "ha": "center", "va": "top"}
        axes.annotate(f"{b['count']}", (b["told"], b["low"]), (0, -3), **below)
    axes.set_xlim(0, 1.0)
    axes.set_ylim(0, 1.0)
    axes.xaxis.set_major_formatter(_PERCENT)
    axes.yaxis.set_major_formatter(_PERCENT)
    axes.set_xlabel("told probability of a verdict, or of the anchors")
    axes.set_title("right answers (of how many)")
    axes.legend(frameon=False, loc="lower right")


def degradation(file: Path, found: Mapping[str, Any]) -> None:
    """Rates with their 95 % intervals against size and noise, as PNG."""
    with plt.rc_context(STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 4.0), dpi=150, layout="constrained", sharey=True)
        _rates(left, found["by_size"], "size of the effect (RMS shift / noise)")
        _rates(right, found["by_noise"], "noise (mm); sizes of at least 3 noises")
        left.set_ylabel("part of the cases")
        left.set_ylim(-0.03, 1.03)
        handles, labels = left.get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, frameon=False, ncols=len(labels), loc="outside lower center")
        figure.savefig(file)
        plt.close(figure)


def _rates(axes: Any, bins: Sequence[Mapping[str, Any]], label: str) -> None:
    """One line per goal; the bins stand side by side, the lines a little apart so that intervals can be told apart."""
    for k, (goal, (colour, marker, dashes)) in enumerate(_LINES.items()):
        shown = [(i, b["rates"][goal]) for i, b in enumerate(bins) if goal in b["rates"]]
        if not shown:
            continue
        x = [i + 0.06 * (k - 2) for i, _ in shown]
        rates = [rate["rate"] for _, rate in shown]
        errors = [
            [max(0.0, rate["rate"] - rate["low"]) for _, rate in shown],
            [max(0.0, rate["high"] - rate["rate"]) for _, rate in shown],
        ]
        axes.errorbar(
            x, rates, yerr=errors, color=colour, marker=marker, ls=dashes, lw=1.4, ms=5, elinewidth=0.7, label=goal
        )
    axes.set_xticks(range(len(bins)), [f"{b['from']:g} to {b['to']:g}" for b in bins])
    axes.set_xlabel(label)
