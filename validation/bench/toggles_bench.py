"""Part 2: all single toggles of {1 2}, against the tutorial doing the same. See docs/bench.md."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from validation.bench.bench_table import BenchTable, Goal, Part, number
from validation.bench.measure import Record, Session, alternate

MEASUREMENT = "slab-12-semicircle"
CENTRE = "1,2"
PATCHES = "12345678"
SIZE, QUICK_SIZE = 3.6, 20.0
"""Element sizes, mm: 3122 nodes, and 158."""

REPEATS = 3
FACTOR = 40.0
AGREE = 1e-6
OURS, TUTORIAL = "bcid", "DOLFINx, tutorial"


def run(session: Session) -> Part:
    """Measure both."""
    part = Part("toggles", "all single toggles of {1 2}, linear elements, the 30 steps of the semicircle")
    size = QUICK_SIZE if session.quick else SIZE
    toggled = [",".join(sorted(set(CENTRE.split(",")) ^ {p})) or "none" for p in PATCHES]
    session.progress.say("toggles: compiling the forms")
    session.run("peers.tutorial_search", size, 1, MEASUREMENT)
    session.run("bcid_toggles", QUICK_SIZE, 1, MEASUREMENT, CENTRE)
    jobs = {
        TUTORIAL: partial(session.run, "peers.tutorial_search", size, 1, MEASUREMENT, *toggled),
        OURS: partial(session.run, "bcid_toggles", size, 1, MEASUREMENT, CENTRE),
    }
    found, errors = alternate(
        jobs, 1 if session.quick else REPEATS, lambda text: session.progress.say(f"toggles: {text}")
    )
    part.notes += [f"{name}: {error}" for name, error in errors.items()]
    part.data = {"found": found, "size_mm": size}
    if errors:
        part.goals = [Goal("times as fast as the tutorial", FACTOR, None)]
        return part
    theirs, ours = (_by_candidate(found[name]) for name in (TUTORIAL, OURS))
    part.tables = [_candidates(theirs, ours), _processes(found, size)]
    part.goals = _goals(found, theirs, ours)
    failed = [c for c, outcome in theirs.items() if outcome["chi2"] is None]
    if failed:
        part.notes.append(f"Newton's method of the tutorial fails for {', '.join(failed)}: it counts as infinitely bad")
    part.notes.append("a candidate that has lost is stopped by bcid: its chi-square is then a lower bound (>)")
    return part


def _by_candidate(record: Record) -> dict[str, dict[str, Any]]:
    return {outcome["candidate"]: outcome for outcome in record["outcomes"]}


def chi2(outcome: dict[str, Any]) -> float:
    """Infinite when the model failed."""
    return math.inf if outcome["chi2"] is None else float(outcome["chi2"])


def _plain(outcome: dict[str, Any]) -> str:
    return "failed" if outcome["chi2"] is None else f"{outcome['chi2']:.8g}"


def _candidates(theirs: dict[str, Any], ours: dict[str, Any]) -> BenchTable:
    rows = []
    for candidate, other in theirs.items():
        mine = ours[candidate]
        sign = "" if mine["complete"] else "> "
        apart = f"{abs(chi2(mine) / chi2(other) - 1):.0e}" if mine["complete"] else "-"
        words = [_plain(other), f"{sign}{_plain(mine)}", apart, f"{100 * mine['share']:.0f} %"]
        rows.append([f"{{{candidate.replace(',', ' ')}}}", *words, number(other["cpu_s"]), number(mine["cpu_s"])])
    columns = ("set", "chi2, tutorial", "chi2, bcid", "apart", "computed", "tutorial CPU s", "bcid CPU s")
    return BenchTable("the eight neighbours", columns, rows)


def _processes(found: dict[str, Record], size: float) -> BenchTable:
    columns = ("code", "set-up s", "wall s", "CPU s", "iterations", "memory MB")
    rows = [
        [name, *(number(r[key]) for key in ("setup_s", "wall_s", "cpu_s", "iterations", "rss_mb"))]
        for name, r in found.items()
    ]
    return BenchTable(f"one process each, elements of {size} mm, {found[OURS]['unknowns']} unknowns", columns, rows)


def _goals(found: dict[str, Record], theirs: dict[str, Any], ours: dict[str, Any]) -> list[Goal]:
    complete = [c for c, outcome in ours.items() if outcome["complete"]]
    apart = max((abs(chi2(ours[c]) / chi2(theirs[c]) - 1) for c in complete), default=math.inf)
    best = min(theirs, key=lambda c: chi2(theirs[c]))
    same = bool(complete) and best == min(complete, key=lambda c: chi2(ours[c]))
    bounded = all(chi2(ours[c]) <= chi2(theirs[c]) * (1 + AGREE) for c in ours if c not in complete)
    return [
        Goal("times as fast as the tutorial (CPU seconds)", FACTOR, found[TUTORIAL]["cpu_s"] / found[OURS]["cpu_s"]),
        Goal("the same best neighbour (1 = yes)", 1, float(same)),
        Goal("complete misfits agree (relative)", AGREE, apart, at_most=True),
        Goal("what was stopped was worse in truth (1 = yes)", 1, float(bounded)),
    ]
