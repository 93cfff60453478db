"""The results of a study: one reader of all trials, and what became of the trials of each cell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcid.base.errors import MachineError
from bcid.base.run_folder import write_whole
from validation.engine.work import read_result
from validation.paper.study_file import StudyFile, Trial
from validation.synthetic.wilson import wilson

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, Any]
_FOUND = ("found", "right", "why", "best", "best_right", "probability", "rms", "cpu_seconds")


def read(study: StudyFile, folder: Path) -> list[Row]:
    """All trials of a study, one row each: its condition, what was found, or why there is nothing.

    Raises:
        InputError: a result is missing or damaged.
    """
    return [_row(trial, folder / f"{trial.name}.json") for trial in study.all_trials()]


def _row(trial: Trial, file: Path) -> Row:
    content = read_result(file)
    result = content["result"] or {}
    about = {"cell": trial.cell, "number": trial.number, "state": content["state"], "reason": content["reason"]}
    about["seconds"] = float(content["seconds"])
    condition = trial.condition.to_json() | {"anchors": sorted(trial.condition.held(trial.number))}
    found = {key: result.get(key) for key in _FOUND}
    return about | condition | found | {"calls": result.get("calls", {}), "stages": result.get("stages", [])}


def frame(rows: Sequence[Row]) -> pd.DataFrame:
    """The rows as a table; sets of patches as text, calls of each level in a column."""
    import pandas as pd

    levels = sorted({level for row in rows for level in row["calls"]})
    flat = []
    for row in rows:
        plain = {
            k: " ".join(v) if isinstance(v, list | tuple) else v for k, v in row.items() if k not in ("calls", "stages")
        }
        flat.append(plain | {f"calls_{level}": row["calls"].get(level) for level in levels})
    return pd.DataFrame(flat)


def write_parquet(rows: Sequence[Row], target: Path) -> None:
    """All trials as Parquet, written whole."""
    stream = BytesIO()
    try:
        frame(rows).to_parquet(stream, index=False)
    except ImportError:
        raise MachineError("pyarrow is not installed; `pip install pyarrow` brings it") from None
    write_whole(target, stream.getvalue())


@dataclass(frozen=True)
class Wrong:
    """A wrong answer: what was anchored, what was found instead, how often, and why (see `identification_trial`)."""

    anchors: tuple[str, ...]
    found: tuple[str, ...]
    count: int
    why: Mapping[str, int]

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        return {"anchors": self.anchors, "found": self.found, "count": self.count, "why": dict(self.why)}


def wrong_answers(rows: Iterable[Row]) -> list[Wrong]:
    """The wrong answers among trials, the commonest first."""
    found: dict[tuple[tuple[str, ...], tuple[str, ...]], Counter[str]] = {}
    for row in rows:
        if row["right"] is False:
            key = tuple(row["anchors"]), tuple(row["found"])
            found.setdefault(key, Counter())[row["why"]] += 1
    made = [Wrong(anchors, answer, why.total(), why) for (anchors, answer), why in found.items()]
    return sorted(made, key=lambda w: (-w.count, w.anchors, w.found))


@dataclass(frozen=True)
class Cell:
    """What became of the trials of a cell.

    Attributes:
        values: what was varied, by attribute.
        count, failed: trials, and those without an answer.
        right, best_right: part of the trials in which the search, and the best of all sets, are the true set; None for the
            second where it is not known.
        interval: of `right`, 95 %, Wilson's.
        calls: mean calls of the model by level.
        rms: median RMS residual of what was found, m.
        seconds: CPU seconds of a search, at what a call takes where it did not make its own: mean, least and most; None where that
            is not known.
        wrong: the wrong answers.
    """

    values: Mapping[str, Any]
    count: int
    failed: int
    right: float
    best_right: float | None
    interval: tuple[float, float]
    calls: Mapping[str, float]
    rms: float | None
    seconds: tuple[float, float, float] | None
    wrong: tuple[Wrong, ...]

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        plain = {
            key: getattr(self, key) for key in ("count", "failed", "right", "best_right", "calls", "rms", "seconds")
        }
        wrong = [each.to_json() for each in self.wrong]
        return {"values": dict(self.values), **plain, "interval": list(self.interval), "wrong": wrong}


def cells(study: StudyFile, rows: Sequence[Row], costs: Mapping[str, float]) -> list[Cell]:
    """The cells of a study, in order; `costs` are the CPU seconds of one call of the model by level."""
    found = []
    for i, condition in enumerate(study.cells()):
        mine = [row for row in rows if row["cell"] == i]
        found.append(_cell({name: getattr(condition, name) for name in study.vary}, mine, costs))
    return found


def _cell(values: Mapping[str, Any], rows: Sequence[Row], costs: Mapping[str, float]) -> Cell:
    good = [row for row in rows if row["right"] is not None]
    hits, best = sum(row["right"] for row in good), sum(bool(row["best_right"]) for row in good)
    known = bool(good) and all(row["best"] is not None for row in good)
    residuals = [row["rms"] for row in good if row["rms"] is not None and np.isfinite(row["rms"])]
    return Cell(
        values,
        len(rows),
        len(rows) - len(good),
        hits / len(rows),
        best / len(rows) if known else None,
        wilson(hits, len(rows)),
        mean_calls(good),
        float(np.median(residuals)) if residuals else None,
        time_range(good, costs),
        tuple(wrong_answers(good)),
    )


def mean_calls(rows: Sequence[Row]) -> dict[str, float]:
    """Mean calls of the model by level."""
    levels = sorted({level for row in rows for level in row["calls"]})
    return {level: float(np.mean([row["calls"].get(level, 0.0) for row in rows])) for level in levels}


def time_range(rows: Sequence[Row], costs: Mapping[str, float]) -> tuple[float, float, float] | None:
    """CPU seconds of the searches: mean, least and most; None where a time is not known."""
    each = [spent(row, costs) for row in rows]
    told = [seconds for seconds in each if seconds is not None]
    return (float(np.mean(told)), min(told), max(told)) if told and len(told) == len(each) else None


def spent(row: Row, costs: Mapping[str, float]) -> float | None:
    """CPU seconds of a search: its own, or what its calls take; None where that is not known."""
    if row["cpu_seconds"] is not None:
        return float(row["cpu_seconds"])
    if not row["calls"] or not all(level in costs for level in row["calls"]):
        return None
    return float(sum(count * costs[level] for level, count in row["calls"].items()))


def rounds(rows: Sequence[Row]) -> list[int]:
    """How many cells are right in each round: the trials of one number."""
    found: dict[int, int] = {}
    for row in rows:
        found[row["number"]] = found.get(row["number"], 0) + bool(row["right"])
    return [found[number] for number in sorted(found)]


def reasons(rows: Sequence[Row], most: int = 3) -> list[tuple[str, int]]:
    """Why trials have no answer, the commonest first, and how many."""
    return Counter(row["reason"] for row in rows if row["right"] is None).most_common(most)
