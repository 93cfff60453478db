"""Part 3: whole identifications on two ranks, against Algorithm 1 written on the tutorial. See docs/bench.md."""

from __future__ import annotations

from typing import Any

import numpy as np

from validation.bench.bench_slab import MEASUREMENTS, scene
from validation.bench.bench_table import BenchTable, Goal, Part, number
from validation.bench.measure import Record, Session

SEEDS = 24
QUICK_SEEDS = 2
RANKS = 2
SAMPLE = {"coarse": 4, "finest": 1, "quick": 2}
EQUIVALENTS = 130.0
READINGS = {"one stage": 250.0, "in stages": 8.0}
"""Of Algorithm 1, and how many times as fast bcid should be."""

LABEL = "count x measured CPU time per trajectory"


def run(session: Session) -> Part:
    """Measure every measurement."""
    part = Part("identification", f"whole identifications, {SEEDS} seeds, {RANKS} ranks, default options")
    names = MEASUREMENTS[:1] if session.quick else MEASUREMENTS
    for name in names:
        part.data[name] = _measure(session, part, name)
    columns = (
        "measurement",
        "answer",
        "certified",
        "level: trajectories",
        "all",
        "wall s",
        "CPU s, all",
        "set-up s",
        "MB per rank",
    )
    part.tables.append(BenchTable("bcid", columns, [_ours(name, part.data[name]["bcid"]) for name in names]))
    readings = (
        "measurement, reading",
        "answer",
        "level: count x s",
        "s on one rank",
        f"s on {RANKS}",
        "× bcid (CPU)",
        "(wall)",
    )
    rows = [_theirs(name, reading, part.data[name]) for name in names for reading in READINGS]
    part.tables.append(BenchTable(f"Algorithm 1 on the tutorial ({LABEL})", readings, rows))
    part.goals = _goals([part.data[name] for name in names])
    part.notes += [
        f"Algorithm 1 is not run whole, which would take hours: its time is {LABEL}, divided by {RANKS} as if it scaled perfectly",
        "its sets in one stage are counted with the misfits of the level below the finest",
    ]
    return part


def _measure(session: Session, part: Part, name: str) -> dict[str, Any]:
    smaller = (1,) if session.quick else ()
    seeds = QUICK_SEEDS if session.quick else SEEDS
    session.progress.say(f"identification, {name}: bcid")
    ours = session.run("bcid_identification", name, *smaller, ranks=RANKS)
    finest = int(ours["finest"])
    session.progress.say(f"identification, {name}: which sets Algorithm 1 looks at")
    counted = session.run("algorithm1_sets", name, seeds, min(1, finest), finest, ranks=RANKS)
    readings = counted["readings"]
    seconds = {}
    for level in sorted({stage["level"] for reading in readings.values() for stage in reading["stages"]}):
        session.progress.say(f"identification, {name}: the tutorial on a sample of the sets of level {level}")
        visited = max((s["visited"] for r in readings.values() for s in r["stages"] if s["level"] == level), key=len)
        seconds[level] = _sample(session, part, name, level, visited, finest)
    for reading in readings.values():
        costs = [len(stage["visited"]) * seconds[stage["level"]]["seconds"] for stage in reading["stages"]]
        reading["seconds"] = sum(costs)
        # On an idle machine the same: a rank that waits uses its core.
        reading["times"] = sum(costs) / ours["cpu_s"]
        reading["times_wall"] = sum(costs) / RANKS / ours["wall_s"]
    truth = ",".join(name.split("-")[1])
    wrong = [reading for reading, found in readings.items() if found["answer"] != truth]
    part.notes += [
        f"{name}: Algorithm 1, {reading}, ends on another set than the measurement was made with" for reading in wrong
    ]
    return {
        "bcid": ours,
        "truth": truth,
        "readings": readings,
        "tutorial": {str(level): found for level, found in seconds.items()},
    }


def _sample(session: Session, part: Part, name: str, level: int, visited: list[str], finest: int) -> Record:
    """CPU seconds of a trajectory of the tutorial: the median of a random sample of sets."""
    rung = scene().levels[level]
    assert rung.element_size is not None
    wanted = SAMPLE["quick" if session.quick else "finest" if level == finest and level > 1 else "coarse"]
    order = [str(word) for word in np.random.default_rng(level).permutation(visited)]
    mesh = (rung.element_size * 1e3, rung.degree, name)
    outcomes: list[dict[str, Any]] = []
    # One that failed on its way says little of what a trajectory costs: one more is drawn for it.
    while len(outcomes) < len(order) and sum(not o["why"] for o in outcomes) < wanted:
        first = len(outcomes)
        last = first + max(1, wanted - sum(not o["why"] for o in outcomes))
        outcomes += session.run("peers.tutorial_search", *mesh, *order[first:last])["outcomes"]
    times = [o["cpu_s"] for o in outcomes]
    failed = sum(bool(o["why"]) for o in outcomes)
    if failed:
        part.notes.append(
            f"{name}, level {level}: Newton's method of the tutorial failed for {failed} of {len(times)} sampled sets"
        )
    return {"seconds": float(np.median(times)), "sample": outcomes}


def _words(word: str) -> str:
    return "{" + word.replace(",", " ") + "}"


def _ours(name: str, ours: Record) -> list[str]:
    evaluations = ours["evaluations"]
    per_level = ", ".join(f"{level}: {number(count)}" for level, count in evaluations.items())
    counts = [number(sum(evaluations.values()))]
    times = [number(ours[key]) for key in ("wall_s", "cpu_s", "setup_s", "rss_mb")]
    return [name, _words(ours["answer"]), "yes" if ours["certified"] else "NO", per_level, *counts, *times]


def _theirs(name: str, reading: str, found: dict[str, Any]) -> list[str]:
    theirs = found["readings"][reading]
    costs = ", ".join(
        f"{s['level']}: {len(s['visited'])} x {number(found['tutorial'][str(s['level'])]['seconds'])}"
        for s in theirs["stages"]
    )
    times = [number(theirs["seconds"]), number(theirs["seconds"] / RANKS)]
    times += [number(theirs["times"]), number(theirs["times_wall"])]
    return [f"{name}, {reading}", _words(theirs["answer"]), costs, *times]


def _goals(found: list[dict[str, Any]]) -> list[Goal]:
    """The worst of all measurements stands for them."""
    ours = [one["bcid"] for one in found]
    counts = [sum(o["evaluations"].values()) for o in ours]
    same = all(one["readings"]["one stage"]["answer"] == one["bcid"]["answer"] for one in found)
    right = all(one["bcid"]["answer"] == one["truth"] for one in found)
    goals = [
        Goal(
            f"times as fast as Algorithm 1, {reading} (CPU seconds, worst)",
            wanted,
            min(one["readings"][reading]["times"] for one in found),
        )
        for reading, wanted in READINGS.items()
    ]
    return [
        *goals,
        Goal("whole-trajectory equivalents (most)", EQUIVALENTS, max(counts), at_most=True),
        Goal("the same answer as Algorithm 1 in one stage (1 = yes)", 1, float(same)),
        Goal("the patches with which the measurements were made (1 = yes)", 1, float(right)),
        Goal("certified (1 = yes)", 1, float(all(o["certified"] for o in ours))),
    ]
