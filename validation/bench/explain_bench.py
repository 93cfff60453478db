"""Part 4: what a diagnosis costs, and what ranking the missing effects does. See docs/bench.md."""

from __future__ import annotations

from typing import Any

from validation.bench.bench_slab import DEMO
from validation.bench.bench_table import BenchTable, Goal, Part, number
from validation.bench.measure import Record, Session

HIDDEN = ("hidden-a", "hidden-d")
"""Measurements of an independent code, with fibres and with nothing hidden; the demo's has a weight."""

DEMO_CPU, WORST_CPU = 20.0, 60.0
RANKED = {"all": 2.5, "plain": 1.5}
WORDS = {"all": "all", "plain": "without history or place"}


def run(session: Session) -> Part:
    """Explain the measurements, and rank the effects of the first."""
    part = Part("explain", "a diagnosis from the scene to the verdict, one core")
    session.progress.say("explain: where the time goes")
    reduced = ["quick"] if session.quick else []
    profiled = session.run("bcid_explain", DEMO, session.scratch / "explain-profiled", "profile", *reduced)
    # Forms are compiled by then.
    found = {DEMO: profiled} if session.quick else {}
    for name in () if session.quick else (DEMO, *HIDDEN):
        session.progress.say(f"explain: {name}")
        found[name] = session.run("bcid_explain", name, session.scratch / f"explain-{name}")
    session.progress.say("explain: ranking the effects")
    ranking = session.run("bcid_ranking", *reduced)
    part.data = {"found": found, "ranking": ranking, "spent": profiled["spent"]}
    part.tables = [_diagnoses(found), _spent(profiled["spent"]), _ranking(ranking)]
    worst = max(record["cpu_s"] for record in found.values())
    part.goals = [
        Goal("explain, the demo (CPU seconds)", DEMO_CPU, session.full(found[DEMO]["cpu_s"]), at_most=True),
        Goal("explain, the worst of these (CPU seconds)", WORST_CPU, session.full(worst), at_most=True),
        *(
            Goal(f"ranking effects, {WORDS[which]} (trajectories)", wanted, _times(ranking, which), at_most=True)
            for which, wanted in RANKED.items()
        ),
    ]
    part.notes.append("explain: what the command does without its picture; forms are compiled already")
    return part


def _diagnoses(found: dict[str, Record]) -> BenchTable:
    columns = ("measurement", "verdict", "anchors", "residual mm", "CPU s", "wall s", "trajectories", "memory MB")
    rows = []
    for name, r in found.items():
        verdict = f"{r['verdict']} {100 * r['verdict_probability']:.1f} %"
        levels = " + ".join(f"{number(count)} {level}" for level, count in r["trajectories"].items())
        values = [number(r[key]) for key in ("rms", "cpu_s", "wall_s")]
        rows.append([name, verdict, " ".join(r["anchored"]), *values, levels, number(r["rss_mb"])])
    return BenchTable("one process each", columns, rows)


def _spent(shares: dict[str, float]) -> BenchTable:
    rows = [[kind, f"{100 * share:.0f} %"] for kind, share in shares.items()]
    return BenchTable(f"where the time of {DEMO} goes, by a profiler", ("work", "share"), rows)


def _ranking(r: Record) -> BenchTable:
    rows = [
        [WORDS[which], str(r[which]["effects"]), number(r[which]["cpu_s"]), number(_times(r, which))]
        for which in RANKED
    ]
    title = f"ranking the effects that {DEMO} lacks; a trajectory of {r['frames']} frames: {r['trajectory_s']:.2f} s"
    return BenchTable(title, ("effects", "number", "CPU s", "trajectories"), rows)


def _times(ranking: dict[str, Any], which: str) -> float:
    return float(ranking[which]["cpu_s"] / ranking["trajectory_s"])
