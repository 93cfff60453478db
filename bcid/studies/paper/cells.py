"""The results of a study: one reader of all trials, the table of its cells, and what the paper says beside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcid.base.errors import MachineError
from bcid.base.run_folder import writing
from bcid.studies.engine.work import read_result
from bcid.studies.hidden.score import wilson
from bcid.studies.paper.condition import written
from bcid.studies.paper.study_file import StudyFile, Trial

if TYPE_CHECKING:
    import pandas as pd

Row = dict[str, Any]


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
    found = {key: result.get(key) for key in ("found", "right", "best", "best_right", "rms", "cpu_seconds")}
    return about | condition | found | {"calls": result.get("calls", {})}


def frame(rows: Sequence[Row]) -> pd.DataFrame:
    """The rows as a table; sets of patches as text, calls of each level in a column."""
    import pandas as pd

    levels = sorted({level for row in rows for level in row["calls"]})
    flat = []
    for row in rows:
        plain = {k: " ".join(v) if isinstance(v, list | tuple) else v for k, v in row.items() if k != "calls"}
        flat.append(plain | {f"calls_{level}": row["calls"].get(level) for level in levels})
    return pd.DataFrame(flat)


def write_parquet(rows: Sequence[Row], target: Path) -> None:
    """All trials as Parquet, written whole."""
    partial = target.with_name(f".{target.name}.partial")
    with writing(target.parent):
        try:
            frame(rows).to_parquet(partial, index=False)
        except ImportError:
            raise MachineError("pyarrow is not installed; `pip install bcid[studies]` brings it") from None
        partial.replace(target)


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
        seconds: mean CPU seconds of a search that made its own calls; None for others.
    """

    values: Mapping[str, Any]
    count: int
    failed: int
    right: float
    best_right: float | None
    interval: tuple[float, float]
    calls: Mapping[str, float]
    rms: float | None
    seconds: float | None

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        plain = {
            key: getattr(self, key) for key in ("count", "failed", "right", "best_right", "calls", "rms", "seconds")
        }
        return {"values": dict(self.values), **plain, "interval": list(self.interval)}


def cells(study: StudyFile, rows: Sequence[Row]) -> list[Cell]:
    """The cells of a study, in order."""
    found = []
    for i, condition in enumerate(study.cells()):
        mine = [row for row in rows if row["cell"] == i]
        found.append(_cell({name: getattr(condition, name) for name in study.vary}, mine))
    return found


def _cell(values: Mapping[str, Any], rows: Sequence[Row]) -> Cell:
    good = [row for row in rows if row["right"] is not None]
    hits, best = sum(row["right"] for row in good), sum(bool(row["best_right"]) for row in good)
    known = bool(good) and all(row["best"] for row in good)
    levels = sorted({level for row in good for level in row["calls"]})
    seconds = [row["cpu_seconds"] for row in good if row["cpu_seconds"] is not None]
    residuals = [row["rms"] for row in good if row["rms"] is not None and np.isfinite(row["rms"])]
    return Cell(
        values,
        len(rows),
        len(rows) - len(good),
        hits / len(rows),
        best / len(rows) if known else None,
        wilson(hits, len(rows)),
        {level: float(np.mean([row["calls"].get(level, 0.0) for row in good])) for level in levels},
        float(np.median(residuals)) if residuals else None,
        float(np.mean(seconds)) if seconds else None,
    )


def together(rows: Sequence[Row]) -> list[int]:
    """How many cells are right in each round: the trials of one number."""
    rounds: dict[int, int] = {}
    for row in rows:
        rounds[row["number"]] = rounds.get(row["number"], 0) + bool(row["right"])
    return [rounds[number] for number in sorted(rounds)]


def text(study: StudyFile, rows: Sequence[Row], costs: Mapping[str, float]) -> str:
    """The table of a study in words and numbers.

    `costs` are the CPU seconds of one call of the model by level.
    """
    found = cells(study, rows)
    lines = [f"{study.title}  (section {study.section})", *([study.about.strip()] if study.about else []), ""]
    failed = sum(cell.failed for cell in found)
    lines.append(
        f"{len(rows)} trials, {study.trials} in each of {len(found)} cells" + (f"; {failed} failed" if failed else "")
    )
    lines.append(
        "In per cent: the search is right / the best of all sets is. A lower first: the search misses what the data tell."
    )
    lines += [f"  {count} failed: {reason}" for reason, count in reasons(rows)]
    for heading, group in _groups(study, found):
        lines += ["", *([heading] if heading else []), *_grid(study, group)]
    lines += ["", *_costs(study, found, costs), *_paper(study, found, rows, costs)]
    return "\n".join(lines).rstrip() + "\n"


def reasons(rows: Sequence[Row], most: int = 3) -> list[tuple[str, int]]:
    """Why trials have no answer, the commonest first, and how many."""
    return Counter(row["reason"] for row in rows if row["right"] is None).most_common(most)


def _groups(study: StudyFile, found: Sequence[Cell]) -> list[tuple[str, list[Cell]]]:
    """The cells of each table: those that are alike but for rows and columns."""
    others = [name for name in study.vary if name not in (study.rows, study.columns)]
    groups: dict[str, list[Cell]] = {}
    for cell in found:
        heading = ", ".join(f"{name} {written(name, cell.values[name])}" for name in others)
        groups.setdefault(heading, []).append(cell)
    return list(groups.items())


def _grid(study: StudyFile, group: Sequence[Cell]) -> list[str]:
    rows = study.vary.get(study.rows, (None,))
    columns = study.vary.get(study.columns, (None,))
    head = [study.rows] + [written(study.columns, c) if study.columns else "" for c in columns]
    body = []
    for r in rows:
        line = [written(study.rows, r) if study.rows else ""]
        for c in columns:
            cell = next(x for x in group if x.values.get(study.rows) == r and x.values.get(study.columns) == c)
            line.append(_rates(cell))
        body.append(line)
    title = f"{'':{max(len(head[0]), *(len(b[0]) for b in body))}}  {study.columns}" if study.columns else ""
    return [*([title] if title else []), *aligned([head, *body])]


def _rates(cell: Cell) -> str:
    best = "-" if cell.best_right is None else f"{100 * cell.best_right:.0f}"
    return f"{100 * cell.right:.0f} / {best}"


def aligned(lines: Sequence[Sequence[str]]) -> list[str]:
    """Columns of text under each other, all but the first to the right."""
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return [
        "  ".join(
            f"{word:<{w}}" if i == 0 else f"{word:>{w}}" for i, (word, w) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    ]


def _costs(study: StudyFile, found: Sequence[Cell], costs: Mapping[str, float]) -> list[str]:
    """Calls of the model and what they take, by how it is searched."""
    searches = study.vary.get("search", (study.setting.search,))
    lines = []
    for search in searches:
        mine = [cell for cell in found if cell.values.get("search", search) == search and cell.calls]
        if not mine:
            continue
        levels = sorted({level for cell in mine for level in cell.calls})
        calls = {level: float(np.mean([cell.calls.get(level, 0.0) for cell in mine])) for level in levels}
        told = " + ".join(f"{count:.1f}" for count in calls.values())
        line = f"{search}: {told} calls of the model on levels {', '.join(levels)} (mean)"
        if all(cell.seconds is not None for cell in mine):
            line += f", {np.mean([cell.seconds for cell in mine if cell.seconds is not None]):.1f} CPU s"
        else:
            each = [spent(cell, costs) for cell in mine]
            told_seconds = [seconds for seconds in each if seconds is not None]
            line += f", {np.mean(told_seconds):.1f} CPU s at what a call takes" if told_seconds else ""
        lines.append(line)
    return lines


def spent(cell: Cell, costs: Mapping[str, float]) -> float | None:
    """CPU seconds of a search: its own, or what its calls take; None where that is not known."""
    if cell.seconds is not None:
        return cell.seconds
    if not cell.calls or not all(level in costs for level in cell.calls):
        return None
    return float(sum(count * costs[level] for level, count in cell.calls.items()))


def _paper(study: StudyFile, found: Sequence[Cell], rows: Sequence[Row], costs: Mapping[str, float]) -> list[str]:
    """What the paper says, and what was found here."""
    lines = []
    for entry in study.paper:
        where = entry["where"]
        mine = [cell for cell in found if all(cell.values.get(name) == value for name, value in where.items())]
        place = ", ".join(f"{name} {written(name, value)}" for name, value in where.items())
        told = [entry["says"]] if "says" in entry else []
        if "right" in entry and mine:
            here = sum(cell.right * cell.count for cell in mine) / sum(cell.count for cell in mine)
            told.append(f"{100 * entry['right']:.0f} % right; here {100 * here:.1f} %")
        if "calls" in entry and mine:
            levels = sorted({level for cell in mine for level in cell.calls})
            here_calls = " + ".join(f"{np.mean([c.calls.get(level, 0.0) for c in mine]):.1f}" for level in levels)
            told.append(f"{' + '.join(f'{c:g}' for c in entry['calls'])} calls; here {here_calls}")
        if "seconds" in entry and mine:
            seconds = [s for s in (spent(cell, costs) for cell in mine) if s is not None]
            told.append(
                f"{entry['seconds']:g} s on average" + (f"; here {np.mean(seconds):.1f} CPU s" if seconds else "")
            )
        if "right_of_18" in entry:
            each = together(rows)
            told.append(
                f"at most {entry['right_of_18']} of 18; here {np.median(each):g} of {len(found)} (median of {len(each)} "
                f"rounds, {min(each)} to {max(each)})"
            )
        lines.append("paper" + (f", {place}" if place else "") + ": " + "; ".join(told))
    return lines
