"""Part 4: how the cost grows with the mesh and with the ranks, and how far the limit is. See docs/bench.md."""

from __future__ import annotations

import os
from typing import Any

from benchmarks.measure import Record, Session, alternate
from benchmarks.plots import mesh_growth, rank_growth, slope
from benchmarks.slab import MEASUREMENTS
from benchmarks.table import Goal, Part, Table, number

# Bricks along an edge and through the thickness, and steps: 1e3 to 1e6 unknowns. The last is solved with multigrid.
SIZES = ((12, 1, 4), (20, 2, 4), (32, 3, 4), (50, 5, 4), (80, 8, 3), (148, 14, 2))
QUICK_SIZES = SIZES[:3]
RANKS = (1, 2)
REPEATS = 2
MIB = 2.0**20
FITTED = {
    "cpu_step_s": "step",
    "factor_s": "factorisation",
    "triangular_s": "triangular solve",
    "residual_s": "residual",
    "triangular_limit_s": "limit of the triangular solve",
}


def run(session: Session) -> Part:
    """Measure every kind of growth there is."""
    part = Part("growth", "how the cost grows, and how far the limit is")
    by_mesh(session, part)
    by_ranks(session, part)
    # Growth with the number of patches, and the replay of an identification to 1024 ranks, have their place here: each a
    # function like the two above that adds its table, goals, data and plot to the part.
    return part


# -- mesh
# ------------------------------------------------------------------------------------------------------------------


def by_mesh(session: Session, part: Part) -> None:
    """A pull of a few steps on finer and finer meshes."""
    speed = session.run("bcid_growth", "bandwidth")
    fastest = max(speed.values())
    found = []
    for along, across, steps in QUICK_SIZES if session.quick else SIZES:
        session.progress.say(f"growth, mesh: {along} x {along} x {across} bricks")
        found.append(_completed(session.run("bcid_growth", along, across, steps), fastest))
    part.data["mesh"] = {"bandwidth": speed, "found": found}
    part.tables += [_mesh_table(found), _limit_table(found, speed), _exponents(found)]
    part.notes.append(
        "step: CPU seconds per load step, everything counted; the largest mesh is solved with multigrid (gamg)"
    )
    mesh_growth(session.folder / "growth-mesh.png", found, FITTED, part, size=(8.0, 4.2))


def _completed(record: Record, fastest: float) -> Record:
    """With the time of a step, and what memory traffic alone costs at the bandwidth `fastest` (bytes/s)."""
    record["cpu_step_s"] = record["cpu_s"] / record["steps"]
    record["iteration_s"] = record["cpu_s"] / max(record["iterations"], 1)
    if record["direct"]:
        # Every entry of the factor goes by twice, forwards and backwards, 8 bytes each: CHOLMOD's supernodes need hardly
        # any indices.
        record["triangular_limit_s"] = 2 * 8 * record["factor_nonzeros"] / fastest
        # Dofs and geometry of a cell, 4 bytes each; place, displacement and force of a node, the force read and written.
        record["residual_limit_s"] = (32 * record["cells"] + 96 * record["nodes"]) / fastest
    return record


def _mesh_table(found: list[Record]) -> Table:
    columns = (
        "unknowns",
        "solver",
        "set-up s",
        "step s",
        "iterations",
        "factorisation s",
        "solve s",
        "residual s",
        "memory MB",
    )
    rows = []
    for r in found:
        parts = [number(r[key]) if key in r else "-" for key in ("factor_s", "triangular_s", "residual_s")]
        solver = "CHOLMOD" if r["direct"] else "gamg"
        rows.append(
            [
                str(r["unknowns"]),
                solver,
                number(r["setup_s"]),
                number(r["cpu_step_s"]),
                number(r["iterations"] / r["steps"]),
                *parts,
                number(r["rss_mb"]),
            ]
        )
    return Table("mesh: per step, one rank (iterations per step)", columns, rows)


def _limit_table(found: list[Record], speed: dict[str, float]) -> Table:
    columns = (
        "unknowns",
        "factor MB",
        "solve: limit ms",
        "times it",
        "residual: limit ms",
        "times it",
        "iteration: times both",
    )
    rows = []
    for r in found:
        if not r["direct"]:
            continue
        solve, forces = r["triangular_limit_s"], r["residual_limit_s"]
        rows.append(
            [
                str(r["unknowns"]),
                number(8 * r["factor_nonzeros"] / MIB),
                number(1e3 * solve),
                number(r["triangular_s"] / solve),
                number(1e3 * forces),
                number(r["residual_s"] / forces),
                number(r["iteration_s"] / (solve + forces)),
            ]
        )
    gigabytes = {name: f"{1e-9 * value:.1f} GB/s" for name, value in speed.items()}
    title = "the limit: memory traffic of one triangular solve and one residual"
    return Table(f"{title} (triad {gigabytes['triad_Bps']}, reading {gigabytes['read_Bps']})", columns, rows)


def _exponents(found: list[Record]) -> Table:
    rows = []
    for key, words in (*FITTED.items(), ("rss_mb", "memory")):
        points = [(r["unknowns"], r[key]) for r in found if r["direct"] and key in r]
        rows.append([words, number(slope(*zip(*points, strict=True))[0])])
    return Table("exponents of the unknowns, direct solver, all sizes", ("what", "exponent"), rows)


# -- ranks
# -----------------------------------------------------------------------------------------------------------------


def by_ranks(session: Session, part: Part) -> None:
    """A whole identification on one rank and on two."""
    smaller = (2, 0) if session.quick else ()

    def job(ranks: int) -> Any:
        return lambda: session.run("bcid_identification", MEASUREMENTS[0], *smaller, ranks=ranks)

    jobs = {str(ranks): job(ranks) for ranks in RANKS}
    repeats = 1 if session.quick else REPEATS
    found, errors = alternate(jobs, repeats, lambda text: session.progress.say(f"growth, ranks: {text}"), slow=1000.0)
    part.notes += [f"{ranks} ranks: left out, {error}" for ranks, error in errors.items()]
    if errors:
        return
    one = found["1"]
    rows = []
    for ranks, record in found.items():
        record["efficiency_wall"] = one["wall_s"] / (int(ranks) * record["wall_s"])
        # A rank that waits uses its core: what all of them use is what the cores are taken for, whoever else is there.
        record["efficiency"] = one["cpu_s"] / record["cpu_s"]
        values = [record[key] for key in ("wall_s", "cpu_s", "efficiency", "efficiency_wall", "setup_s", "rss_mb")]
        rows.append([ranks, *map(number, values)])
    part.data["ranks"] = found
    columns = ("ranks", "wall s", "CPU s, all", "efficiency (CPU)", "(wall)", "set-up s", "MB per rank")
    part.tables.append(Table(f"ranks: identification of {MEASUREMENTS[0]}", columns, rows))
    same = len({(r["answer"], r["probability"]) for r in found.values()}) == 1
    part.goals.append(Goal("the same answer and probability on every number of ranks (1 = yes)", 1, float(same)))
    part.notes.append(f"this process may use {len(os.sched_getaffinity(0))} core(s)")
    rank_growth(
        session.folder / "growth-ranks.png",
        {int(n): r["cpu_s"] / int(n) for n, r in found.items()},
        part,
        size=(4.2, 3.4),
    )
