"""Part 5: how long a robot waits for the next pull, and what predicting every set costs. See docs/bench.md."""

from __future__ import annotations

from validation.bench.bench_table import BenchTable, Goal, Part, number
from validation.bench.measure import Record, Session

COMMAND_CPU, PULLS_CPU = 30.0, 240.0
EVERY, FIRST, QUICK_EVERY = 8, 3, 64
"""Of the sets: every so many, from that one on; a sample of all, since all of them take minutes."""

GRASP, BUDGET, RANKS = "II", 0.5, 2
"""Grasp and budget of the reduced form, which may choose a pull but not make it; ranks that predict."""


def run(session: Session) -> Part:
    """Explore as in the README, and predict a sample of all sets for every pull."""
    part = Part("explore", "an exploration with a simulated robot, one core; every set's pulls, two ranks")
    less = (GRASP, BUDGET) if session.quick else ()
    if not session.quick:
        session.progress.say("explore: compiling the forms")
        session.run("bcid_explore", session.scratch / "explore-warm-up", GRASP, BUDGET)
    session.progress.say("explore: the command")
    command = session.run("bcid_explore", session.scratch / "explore", *less)
    session.progress.say("explore: predicting pulls")
    every = QUICK_EVERY if session.quick else EVERY
    pulls = session.run("bcid_pulls", every, FIRST, *less[:1], ranks=RANKS)
    part.data = {"command": command, "pulls": pulls}
    part.tables = [_command(command), _pulls(pulls)]
    part.goals = [
        Goal("the README's explore (CPU seconds)", COMMAND_CPU, session.full(command["cpu_s"]), at_most=True),
        Goal("all sets and pulls, two ranks (CPU seconds)", PULLS_CPU, session.full(whole(pulls)), at_most=True),
    ]
    part.notes.append("explore: what the command does without its picture; forms are compiled already")
    part.notes.append(f"all sets: those of a sample of {pulls['sets']}, times {pulls['all_sets'] / pulls['sets']:g}")
    return part


def whole(pulls: Record) -> float:
    """CPU seconds of a rank for all sets, from those of a sample."""
    return float(pulls["cpu_s"] * pulls["all_sets"] / pulls["sets"])


def _command(r: Record) -> BenchTable:
    columns = ("ended", "anchors", "pulls", "CPU s", "wall s", "predictions by level", "tangents", "memory MB")
    ended = f"{r['reason']}, {100 * r['probability']:.1f} %"
    levels = " + ".join(str(count) for count in r["evaluations"].values())
    values = [number(r["cpu_s"]), number(r["wall_s"]), levels, str(r["tangents"]), number(r["rss_mb"])]
    return BenchTable("one process", columns, [[ended, " ".join(r["anchored"]), str(r["pulls"]), *values]])


def _pulls(r: Record) -> BenchTable:
    columns = ("pulls", "sets", "of", "CPU s of a rank", "wall s", "all sets: CPU s", "not followed", "factorisations")
    values = [number(r["cpu_s"]), number(r["wall_s"]), number(whole(r)), str(r["failed"]), str(r["factorisations"])]
    row = [str(r["pulls"]), str(r["sets"]), str(r["all_sets"]), *values]
    return BenchTable(f"{r['ranks']} ranks, force, strain and stability included", columns, [row])
