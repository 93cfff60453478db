"""The picture of a study: how its rates fall with the size of what is hidden and with the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

# Okabe & Ito's colours; markers and dashes tell the lines apart in black and white.
_LINES = {
    "named": ("#0072B2", "o", "-"),
    "first two": ("#56B4E9", "s", "--"),
    "parameters": ("#009E73", "^", "-."),
    "not misnamed": ("#D55E00", "D", ":"),
    "anchors": ("#000000", "v", (0, (5, 1, 1, 1, 1, 1))),
}


def degradation(file: Path, found: Mapping[str, Any]) -> None:
    """Rates with their 95 % intervals against size and noise, as PNG."""
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
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
