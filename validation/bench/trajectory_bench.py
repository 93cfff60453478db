"""Part 1: one trajectory of the slab40 reference, against peers. See docs/bench.md."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from validation.bench.bench_plots import codes
from validation.bench.bench_table import BenchTable, Goal, Part, number
from validation.bench.measure import Record, Session, alternate
from validation.bench.peers.problem import Array, problem

OURS = "bcid"
SOLVERS = {"DOLFINx, tutorial": "tutorial", "DOLFINx, fast": "fast"}
WHEELS = {"FElupe, PARDISO": "felupe_pardiso", "scikit-fem, PARDISO": "scikit_fem"}
FAST = "DOLFINx, fast"
REPEATS = {"small": 5, "medium": 3, "large": 3}
AGREE = 1e-9
TIMES_THE_LIMIT = 1.8
COLUMNS = ("mesh, code", "set-up s", "wall s", "CPU s", "iterations", "memory MB", "× bcid (CPU)", "(wall)", "error")


def run(session: Session) -> Part:
    """Measure every code on every mesh."""
    part = Part("trajectory", "one trajectory of the slab, 40 steps, rtol 1e-8; displacements against the reference")
    meshes = ("small",) if session.quick else tuple(REPEATS)
    python, why = session.peer_python()
    if python is None:
        part.notes.append(f"{' and '.join(WHEELS)}: {why}")
    _warm_up(session)
    rows, limits = [], []
    for mesh in meshes:
        found, fields = _measure(session, part, mesh, python)
        part.data[mesh] = found
        rows += [_row(mesh, name, found) for name in found]
        limits.append(_limit(mesh, found[OURS]))
        part.data[mesh][OURS]["limit_s"] = _needed(found[OURS])
        part.goals += _goals(mesh, found, fields)
    part.tables.append(BenchTable("one trajectory (medians)", COLUMNS, rows))
    columns = ("mesh", "residual ms", "triangular solve ms", "iterations", "limit s", "reached s", "times the limit")
    part.tables.append(BenchTable("the limit: one residual and one triangular solve per iteration", columns, limits))
    codes(session.folder / "trajectory.png", {mesh: part.data[mesh] for mesh in meshes}, part)
    return part


def _warm_up(session: Session) -> None:
    """Forms are compiled when they are first used: that is no part of any set-up time."""
    for module in ("bcid_trajectory", *(f"peers.{name}" for name in SOLVERS.values())):
        session.progress.say(f"trajectory: compiling the forms of {module}")
        session.run(module, "small", session.scratch / "warm-up.npy")


def _measure(session: Session, part: Part, mesh: str, python: str | None) -> tuple[dict[str, Record], dict[str, Array]]:
    fields: dict[str, Path] = {}

    def job(name: str, module: str, interpreter: str | None) -> Record:
        fields[name] = session.scratch / f"{module.split('.')[-1]}-{mesh}.npy"
        return session.run(module, mesh, fields[name], python=interpreter)

    jobs = {name: partial(job, name, f"peers.{module}", None) for name, module in SOLVERS.items()}
    if python is not None:
        jobs |= {name: partial(job, name, f"peers.{module}", python) for name, module in WHEELS.items()}
    jobs |= {OURS: partial(job, OURS, "bcid_trajectory", None)}
    repeats = 2 if session.quick else REPEATS[mesh]
    found, errors = alternate(jobs, repeats, lambda text: session.progress.say(f"trajectory, {mesh}: {text}"))
    part.notes += [f"{mesh}, {name}: left out, {error}" for name, error in errors.items()]
    if OURS not in found:
        found[OURS] = jobs[OURS]()
    arrays = {name: np.load(fields[name]) for name in found}
    reference = problem(mesh)["field"]
    for name, field in arrays.items():
        found[name]["error"] = difference(field, reference)
        # Every process has one thread, so CPU and wall seconds are the same on an idle machine; the former bear neighbours.
        found[name]["times"] = found[name]["cpu_s"] / found[OURS]["cpu_s"]
        found[name]["times_wall"] = found[name]["wall_s"] / found[OURS]["wall_s"]
    return found, arrays | {"the reference": reference}


def difference(a: Array, b: Array) -> float:
    """Largest difference of two fields, as a fraction of the largest value."""
    return float(np.abs(a - b).max() / np.abs(b).max())


def _row(mesh: str, name: str, found: dict[str, Record]) -> list[str]:
    r = found[name]
    times = [r["setup_s"], r["wall_s"], r["cpu_s"], r["iterations"], r["rss_mb"], r["times"], r["times_wall"]]
    return [f"{mesh}, {name}", *map(number, times), f"{r['error']:.0e}"]


def _needed(ours: Record) -> float:
    """Seconds that no Newton iteration of this kind can do without."""
    return float(ours["iterations"] * (ours["residual_s"] + ours["triangular_s"]))


def _limit(mesh: str, ours: Record) -> list[str]:
    needed = _needed(ours)
    parts = [1e3 * ours["residual_s"], 1e3 * ours["triangular_s"], ours["iterations"], needed, ours["cpu_s"]]
    return [mesh, *map(number, parts), number(ours["cpu_s"] / needed)]


def _goals(mesh: str, found: dict[str, Record], fields: dict[str, Array]) -> list[Goal]:
    every = list(fields)
    apart = max(difference(fields[a], fields[b]) for i, a in enumerate(every) for b in every[i + 1 :])
    goals = [Goal(f"{mesh}: displacements of all codes and the reference agree", AGREE, apart, at_most=True)]
    for name in (*SOLVERS, *WHEELS):
        wanted = (8.0 if name == FAST else 6.0) if mesh == "large" else 1.0
        if mesh == "large" or name == FAST:
            reached = found[name]["times"] if name in found else None
            goals.append(Goal(f"{mesh}: times as fast as {name}", wanted, reached))
    if mesh == "large":
        times = found[OURS]["cpu_s"] / _needed(found[OURS])
        goals.append(Goal("large: times the limit", TIMES_THE_LIMIT, times, at_most=True))
    return goals
