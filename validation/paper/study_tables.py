"""The tables of a study, as text and as Markdown: they differ in how their rows are drawn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bcid.base.csv_text import csv_text
from bcid.inference.hypotheses import label
from validation.paper.cells import Cell, Row, Wrong, mean_calls, reasons, time_range, wrong_answers
from validation.paper.claims import TOLD, Claim
from validation.paper.condition import named, written
from validation.paper.study_file import StudyFile
from validation.text_table import TextTable, wrapped

# So many wrong answers are listed; the others are counted.
_LISTED = 12
_WHY = {
    "search": "the search missed a set that fits better on its last mesh",
    "mesh": "that mesh misleads, a finer one does not",
    "data": "another set fits better on the finer mesh too: the data do not tell",
}


def tables(
    study: StudyFile, found: Sequence[Cell], rows: Sequence[Row], costs: Mapping[str, float], said: Sequence[Claim]
) -> list[TextTable]:
    """Everything that is told of a study, as tables."""
    made = [*_rates(study, found)]
    if "rms" in study.also:
        made += _residuals(study, found)
    if "stages" in study.also:
        made.append(_stages(study, rows, costs))
    made += [*_times(study, rows, costs), *_wrong(rows), *_claims(said)]
    return made


def text(study: StudyFile, made: Sequence[TextTable], rows: Sequence[Row]) -> str:
    """All that a study tells, for a terminal."""
    head = [f"{study.title}  (section {study.section})", *([wrapped(study.about)] if study.about else []), ""]
    told = [*head, *counts(rows), "", wrapped(READING)]
    return "\n".join([*told, "", "\n\n".join(table.text() for table in made)]).rstrip() + "\n"


READING = (
    "Per cent: the search is right / the best of all sets is the true one. A lower first number: the search, or its coarse mesh, "
    "missed what the data tell."
)


def counts(rows: Sequence[Row]) -> list[str]:
    """How many trials there are, and why some have no answer."""
    failed = sum(row["right"] is None for row in rows)
    cells = len({row["cell"] for row in rows})
    told = [
        f"{len(rows)} trials, {len(rows) // cells} in each of {cells} cells" + (f"; {failed} failed" if failed else "")
    ]
    return told + [f"  {count} failed: {reason}" for reason, count in reasons(rows)]


def _groups(study: StudyFile, found: Sequence[Cell]) -> list[tuple[str, list[Cell]]]:
    """The cells of each table: those that are alike but for rows and columns."""
    others = [name for name in study.vary if name not in (study.rows, study.columns)]
    groups: dict[str, list[Cell]] = {}
    for cell in found:
        heading = ", ".join(f"{named(name)} {written(name, cell.values[name])}" for name in others)
        groups.setdefault(heading, []).append(cell)
    return list(groups.items())


def _grid(study: StudyFile, group: Sequence[Cell], title: str, told: Any) -> TextTable:
    rows, columns = (study.vary.get(name, (None,)) for name in (study.rows, study.columns))
    corner = " \\ ".join(named(name) for name in (study.rows, study.columns) if name)
    head = [corner] + [written(study.columns, c) if study.columns else "" for c in columns]
    body = []
    for r in rows:
        mine = [next(x for x in group if _at(study, x, r, c)) for c in columns]
        body.append((written(study.rows, r) if study.rows else "", *(told(cell) for cell in mine)))
    return TextTable(title, tuple(head), tuple(body))


def _at(study: StudyFile, cell: Cell, row: Any, column: Any) -> bool:
    return bool(cell.values.get(study.rows) == row and cell.values.get(study.columns) == column)


def _rates(study: StudyFile, found: Sequence[Cell]) -> list[TextTable]:
    return [_grid(study, group, heading, rate) for heading, group in _groups(study, found)]


def rate(cell: Cell) -> str:
    """Per cent of a cell: the search, and the best of all sets."""
    best = "-" if cell.best_right is None else f"{100 * cell.best_right:.0f}"
    return f"{100 * cell.right:.0f} / {best}"


def _residuals(study: StudyFile, found: Sequence[Cell]) -> list[TextTable]:
    def told(cell: Cell) -> str:
        return "-" if cell.rms is None else f"{cell.rms * 1e3:.2f}"

    return [
        _grid(study, group, ", ".join(["RMS error of the markers, mm (median)", *([h] if h else [])]), told)
        for h, group in _groups(study, found)
    ]


def _stages(study: StudyFile, rows: Sequence[Row], costs: Mapping[str, float]) -> TextTable:
    """What each stage ends on, with its calls and times, by what holds the body and how it is searched."""
    body = []
    for anchors in dict.fromkeys(tuple(row["anchors"]) for row in rows):
        for search in dict.fromkeys(row["search"] for row in rows):
            mine = [r for r in rows if tuple(r["anchors"]) == anchors and r["search"] == search and r["stages"]]
            levels = sorted({stage["level"] for row in mine for stage in row["stages"]})
            for level in levels:
                ended = [stage for row in mine for stage in row["stages"] if stage["level"] == level]
                calls = float(np.mean([row["calls"].get(str(level), 0.0) for row in mine]))
                seconds = f"{calls * costs[str(level)]:.3g}" if str(level) in costs else "-"
                body.append(
                    (
                        label(anchors, anchors),
                        search,
                        str(level + 1),
                        _commonest([tuple(stage["anchors"]) for stage in ended]),
                        f"{np.median([stage['rms'] for stage in ended]) * 1e3:.2f}",
                        f"{calls:.3g}",
                        seconds,
                    )
                )
            whole = time_range(mine, costs)
            if len(levels) > 1 and whole:
                total = f"{sum(mean_calls(mine).values()):.3g}"
                body.append((label(anchors, anchors), search, "all", "", "", total, f"{whole[0]:.3g}"))
    head = ("anchored", "search", "mesh", "ends on", "RMS, mm", "calls", "CPU s")
    return TextTable("What each stage ends on", head, tuple(body))


def _commonest(sets: Sequence[tuple[str, ...]]) -> str:
    """The commonest answers; how often where there are several."""
    counted = Counter(sets).most_common()
    if len(counted) == 1:
        return label(counted[0][0], counted[0][0])
    more = f" and {len(counted) - 2} others" if len(counted) > 2 else ""
    return ", ".join(f"{label(a, a)} {n} times" for a, n in counted[:2]) + more


def _times(study: StudyFile, rows: Sequence[Row], costs: Mapping[str, float]) -> list[TextTable]:
    """Calls of the model and what they take, by motion and by how it is searched."""
    body = []
    kinds = dict.fromkeys((row["search"], row["motion"], row["stop"]) for row in rows if row["calls"])
    levels = sorted({level for row in rows for level in row["calls"]})
    for search, motion, stop in kinds:
        mine = [r for r in rows if (r["search"], r["motion"], r["stop"]) == (search, motion, stop) and r["calls"]]
        calls, found = mean_calls(mine), time_range(mine, costs)
        ends = f", until {stop}" if "stop" in study.vary else ""
        each = [f"{calls[level]:.3g}" if level in calls else "-" for level in levels]
        own = mine[0]["cpu_seconds"] is not None
        by_level = [] if own else [calls.get(level, 0.0) * costs.get(level, np.nan) for level in levels]
        parts = " + ".join(f"{seconds:.2g}" for seconds in by_level) or "-"
        told = f"{found[0]:.3g} ({found[1]:.3g} to {found[2]:.3g})" if found else "-"
        body.append((f"{search}, {motion}{ends}", *each, parts, told))
    if not body:
        return []
    head = (
        "calls of the model (mean)",
        *(f"mesh {int(level) + 1}" for level in levels),
        "CPU s by mesh",
        "CPU s (range)",
    )
    return [TextTable("", head, tuple(body))]


def _wrong(rows: Sequence[Row]) -> list[TextTable]:
    """The wrong answers, how often, and why."""
    every = wrong_answers(rows)
    if not every:
        return []
    shown = [_wrong_row(answer) for answer in every[:_LISTED]]
    rest = every[_LISTED:]
    if rest:
        left = Counter[str]()
        for answer in rest:
            left.update(answer.why)
        shown.append(("", f"{len(rest)} others", str(sum(a.count for a in rest)), *(str(left[why]) for why in _WHY)))
    title = "Wrong answers. " + "; ".join(f"{why}: {what}" for why, what in _WHY.items()) + "."
    return [TextTable(title, ("anchored", "found", "times", *_WHY), tuple(shown))]


def _wrong_row(answer: Wrong) -> tuple[str, ...]:
    names = (label(answer.anchors, answer.anchors), label(answer.found, answer.found))
    return (*names, str(answer.count), *(str(answer.why.get(why, 0)) for why in _WHY))


def _claims(said: Sequence[Claim]) -> list[TextTable]:
    if not said:
        return []
    rows = tuple((c.about or "all", c.paper, c.here or "-", c.verdict if c.verdict != TOLD else "") for c in said)
    return [TextTable("", ("of which trials", "the paper", "here", ""), rows)]


def table_csv(study: StudyFile, found: Sequence[Cell]) -> str:
    """The cells as CSV, lengths in mm, times in s."""
    levels = sorted({level for cell in found for level in cell.calls})
    numbers = ("right", "low", "high", "best_right", "rms_mm", "cpu_s", "cpu_s_least", "cpu_s_most")
    rows: list[list[object]] = [[*study.vary, "trials", "failed", *numbers, *(f"calls_{x}" for x in levels), "wrong"]]
    for cell in found:
        values = [cell.right, *cell.interval, cell.best_right, None if cell.rms is None else cell.rms * 1e3]
        values += [*(cell.seconds or (None,) * 3), *(cell.calls.get(level) for level in levels)]
        told = ["" if n is None else f"{n:.6g}" for n in values]
        wrong = "; ".join(f"{label(w.found, w.found)} for {label(w.anchors, w.anchors)}: {w.count}" for w in cell.wrong)
        about = [written(n, v) for n, v in cell.values.items()]
        rows.append([*about, cell.count, cell.failed, *told, wrong])
    return csv_text(rows)
