"""The pictures of study files and of the exploration study: how rates fall with what is varied, and how beliefs grow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from validation.paper.cells import Cell
from validation.paper.condition import named, written
from validation.paper.study_file import StudyFile

# Of the pictures of all studies.
STYLE: dict[Any, Any] = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
# Okabe & Ito's colours, one for each row of a table.
_ROWS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00", "#56B4E9")
_MARKERS = "osD^vPX"
# With fewer trials in a cell a rate is hardly one.
_TRIALS = 4


def success(file: Path, study: StudyFile, found: Sequence[Cell]) -> None:
    """Rates of a study file over its columns, a line for each row: what the search finds, and what the best of all sets is."""
    others = [name for name in study.vary if name not in (study.rows, study.columns)]
    keys = list(dict.fromkeys(tuple(cell.values[name] for name in others) for cell in found))
    count = min(len(keys), 6)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            1, count, figsize=(max(5.6, 3.4 * count), 4.0), dpi=150, layout="constrained", sharey=True, squeeze=False
        )
        for axis, key in zip(axes[0], keys, strict=False):
            mine = [cell for cell in found if tuple(cell.values[name] for name in others) == key]
            _success(axis, study, mine)
            axis.set_title(
                ", ".join(f"{named(n)} {written(n, v)}" for n, v in zip(others, key, strict=True)), fontsize=9
            )
        axes[0][0].set_ylabel("right answers, %")
        axes[0][0].set_ylim(-3, 103)
        handles, labels = axes[0][0].get_legend_handles_labels()
        # As many columns as fit under the axes.
        inches = 0.6 + 0.075 * max(len(text) for text in labels)
        columns = max(1, min(len(labels), int(figure.get_figwidth() / inches)))
        figure.legend(handles, labels, frameon=False, ncols=columns, loc="outside lower center")
        figure.savefig(file)
        plt.close(figure)


def is_curve(study: StudyFile) -> bool:
    """Whether rates over the columns are worth a picture: these are amounts, and there are trials enough for a rate."""
    values = study.vary.get(study.columns, ())
    return len(values) > 1 and all(isinstance(value, float) for value in values) and study.trials >= _TRIALS


def _success(axis: Any, study: StudyFile, cells: Sequence[Cell]) -> None:
    columns = study.vary.get(study.columns, (None,))
    for k, row in enumerate(study.vary.get(study.rows, (None,))):
        mine = [cell for cell in cells if cell.values.get(study.rows) == row]
        colour, marker = _ROWS[k % len(_ROWS)], _MARKERS[k % len(_MARKERS)]
        name = f"{named(study.rows)} {written(study.rows, row)}" if study.rows else "search"
        # Lines that lie on each other stay visible.
        x = np.arange(len(columns)) + 0.04 * (k - len(study.vary.get(study.rows, (None,))) / 2)
        rates = [100 * cell.right for cell in mine]
        low = [max(0.0, 100 * (cell.right - cell.interval[0])) for cell in mine]
        high = [max(0.0, 100 * (cell.interval[1] - cell.right)) for cell in mine]
        axis.errorbar(
            x, rates, yerr=[low, high], color=colour, marker=marker, ms=4.5, lw=1.3, elinewidth=0.6, label=name
        )
        best = [np.nan if cell.best_right is None else 100 * cell.best_right for cell in mine]
        if np.isfinite(best).any():
            axis.plot(x, best, color=colour, lw=1.0, ls=":", label="best of all sets" if k == 0 else None)
    axis.set_xticks(range(len(columns)), [written(study.columns, c) if study.columns else "" for c in columns])
    axis.set_xlabel(named(study.columns))


def progression(file: Path, trials: Sequence[Mapping[str, Any]]) -> None:
    """Probabilities of the likeliest sets after each pull, an axis for each trial, as PNG; the true set is drawn thick."""
    from bcid.inference.hypotheses import label

    if not trials:
        return
    rows = sorted({(t["noise"], len(t["grasps"])) for t in trials})
    columns = list(dict.fromkeys(tuple(t["anchors"]) for t in trials))
    with plt.rc_context(STYLE):
        size = (3.1 * len(columns), 2.2 * len(rows) + 0.3)
        figure, axes = plt.subplots(
            len(rows), len(columns), figsize=size, dpi=150, layout="constrained", sharey=True, squeeze=False
        )
        for trial in trials:
            row = rows.index((trial["noise"], len(trial["grasps"])))
            axis = axes[row][columns.index(tuple(trial["anchors"]))]
            _beliefs(axis, trial, label(trial["anchors"], trial["anchors"]))
            count = len(trial["grasps"])
            noise = f"{trial['noise'] * 1e3:g} mm" if trial["noise"] else "no noise"
            axis.set_title(f"{noise}, {count} grasp{'s' if count > 1 else ''}", fontsize=9)
        for axis in axes[-1]:
            axis.set_xlabel("pull")
        for line in axes:
            line[0].set_ylabel("belief")
        figure.savefig(file)
        plt.close(figure)


def _beliefs(axis: Any, trial: Mapping[str, Any], true: str) -> None:
    """Belief in the true set, and in those that were among the likeliest two after a pull; before the first all are alike."""
    beliefs = trial["beliefs"]
    rivals = [name for belief in beliefs for name in list(belief)[:2] if name != true]
    for k, name in enumerate([true, *list(dict.fromkeys(rivals))[: len(_ROWS) - 1]]):
        shown = [1 / trial["sets"], *(belief.get(name, 0.0) for belief in beliefs)]
        axis.plot(
            range(len(shown)),
            shown,
            color=_ROWS[k],
            marker=_MARKERS[k],
            ms=4,
            lw=2.2 if k == 0 else 1.0,
            label=name,
        )
    axis.set_xticks(range(len(beliefs) + 1))
    axis.set_ylim(-0.03, 1.05)
    axis.legend(frameon=False, fontsize=7)
