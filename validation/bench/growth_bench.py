"""Part 6: how the cost grows with the mesh and with the ranks, and how far the limit is. See docs/bench.md."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from bcid.base.scheduler import replay
from validation.bench.bench_plots import mesh_growth, patch_growth, rank_growth, replay_growth, slope
from validation.bench.bench_slab import MEASUREMENTS
from validation.bench.bench_table import BenchTable, Goal, Part, number
from validation.bench.measure import Record, Session, alternate

# Bricks along an edge and through the thickness, and steps: 1e3 to 1e6 unknowns. The last is solved with multigrid.
SIZES = ((12, 1, 4), (20, 2, 4), (32, 3, 4), (50, 5, 4), (80, 8, 3), (148, 14, 2))
QUICK_SIZES = SIZES[:2]
RANKS = (1, 2)
REPEATS = 2
EFFICIENT = 0.85
# Wanted: a step of the largest mesh (CPU s), its memory (MB), the exponent of a step with the direct solver, and the
# efficiency of an identification replayed on 16 ranks.
LARGE_STEP, LARGE_MEMORY, STEP_EXPONENT, REPLAYED_EFFICIENT = 15.0, 3000.0, 1.25, 0.7
REPLAYED, AT = (1, 2, 16, 64, 256, 1024), 16
# Sets of 12 patches, and what taking one from the counter is charged with, s.
MANY, LATENCY = 4096, 20e-6
# Halvings of the slab's eight patches, and elements (mm) with which every piece has facets.
HALVINGS, PIECES = (0, 1, 2, 3), 7.2
QUICK_HALVINGS, QUICK_PIECES = (0, 1), 20.0
MIB = 2.0**20
REPLAY_COLUMNS = ("work", "ranks", "s", "speed-up", "efficiency", "at most")
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
    by_patches(session, part)
    by_ranks(session, part)
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
    part.notes.append("step: CPU seconds per load step, everything counted; the largest mesh is solved with multigrid")
    part.goals += _mesh_goals(session, found)
    mesh_growth(session.folder / "growth-mesh.png", found, FITTED, part, size=(8.0, 4.2))


def _mesh_goals(session: Session, found: list[Record]) -> list[Goal]:
    """What the largest mesh takes, and how a step grows on the meshes that are factorised."""
    direct = [(r["unknowns"], r["cpu_step_s"]) for r in found if r["direct"]]
    reached = {
        "1e6 unknowns, a step (CPU seconds)": (LARGE_STEP, found[-1]["cpu_step_s"]),
        "1e6 unknowns, memory (MB)": (LARGE_MEMORY, found[-1]["rss_mb"]),
        "exponent of a step in unknowns, direct solver": (STEP_EXPONENT, slope(*zip(*direct, strict=True))[0]),
    }
    return [Goal(what, wanted, session.full(value), at_most=True) for what, (wanted, value) in reached.items()]


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


def _mesh_table(found: list[Record]) -> BenchTable:
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
        solver = "CHOLMOD" if r["direct"] else "multigrid"
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
    return BenchTable("mesh: per step, one rank (iterations per step)", columns, rows)


def _limit_table(found: list[Record], speed: dict[str, float]) -> BenchTable:
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
    return BenchTable(f"{title} (triad {gigabytes['triad_Bps']}, reading {gigabytes['read_Bps']})", columns, rows)


def _exponents(found: list[Record]) -> BenchTable:
    rows = []
    for key, words in (*FITTED.items(), ("rss_mb", "memory")):
        points = [(r["unknowns"], r[key]) for r in found if r["direct"] and key in r]
        rows.append([words, number(slope(*zip(*points, strict=True))[0])])
    return BenchTable("exponents of the unknowns, direct solver, all sizes", ("what", "exponent"), rows)


# -- patches
# ---------------------------------------------------------------------------------------------------------------


def by_patches(session: Session, part: Part) -> None:
    """A climb with more and more patches on one mesh, on two ranks."""
    size = QUICK_PIECES if session.quick else PIECES
    found = []
    for halvings in QUICK_HALVINGS if session.quick else HALVINGS:
        session.progress.say(f"growth, patches: {8 * 2**halvings}")
        found.append(session.run("bcid_patches", halvings, size, ranks=2))
    rows = []
    for r in found:
        values = [r["sets"], r["trajectories"], r["wall_s"], r["cpu_s"] / r["trajectories"], r["rms_mm"]]
        rows.append([str(r["patches"]), *map(number, values), str(r["wrong"])])
    columns = (
        "patches",
        "sets looked at",
        "trajectories",
        "wall s",
        "CPU s per trajectory",
        "residual mm",
        "wrong pieces",
    )
    part.tables.append(
        BenchTable(
            f"patches: one climb, from the answer for half as many; linear elements of {size:g} mm, 2 ranks",
            columns,
            rows,
        )
    )
    patches = [r["patches"] for r in found]
    exponents = {
        words: slope(patches, [r[key] for r in found])[0]
        for words, key in (("sets looked at", "sets"), ("trajectories", "trajectories"), ("CPU seconds", "cpu_s"))
    }
    rows = [[words, number(value)] for words, value in exponents.items()]
    part.tables.append(BenchTable("exponents of the number of patches", ("what", "exponent"), rows))
    part.data["patches"] = {"found": found, "exponents": exponents}
    patch_growth(session.folder / "growth-patches.png", found, part, size=(4.6, 3.6))


# -- ranks
# -----------------------------------------------------------------------------------------------------------------


def by_ranks(session: Session, part: Part) -> None:
    """A whole identification on one rank and on two."""
    smaller = (0,) if session.quick else ()

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
    part.tables.append(BenchTable(f"ranks: identification of {MEASUREMENTS[0]}", columns, rows))
    same = len({(r["answer"], r["probability"]) for r in found.values()}) == 1
    part.goals.append(Goal("the same answer and probability on every number of ranks (1 = yes)", 1, float(same)))
    part.notes.append(f"this process may use {len(os.sched_getaffinity(0))} core(s)")
    efficiency = found[str(RANKS[-1])]["efficiency_wall"]
    part.goals.append(Goal("efficiency of two ranks (wall)", EFFICIENT, efficiency))
    _replay(session, part, one["batches"])
    rank_growth(
        session.folder / "growth-ranks.png",
        {int(n): r["cpu_s"] / int(n) for n, r in found.items()},
        part,
        size=(4.2, 3.4),
    )


def most_efficient(batches: list[list[float]], ranks: int) -> float:
    """Efficiency that no way of dealing out sets can exceed: the longest of every batch must be waited for, one after the other."""
    work, waited = sum(map(sum, batches)), sum(map(max, batches))
    return work / max(work, ranks * waited)


def _replay(session: Session, part: Part, batches: list[list[float]]) -> None:
    """The measured durations dealt out to more ranks by the code that deals them out; each batch ends with a barrier."""
    longest = max(batches, key=len)
    drawn = np.random.default_rng(0).choice(longest, size=MANY).tolist()
    jobs: dict[str, list[Any]] = {"identification, 8 patches": batches, "all sets of 12 patches": [drawn]}
    curves: dict[str, dict[int, float]] = {}
    possible = {name: {ranks: most_efficient(work, ranks) for ranks in REPLAYED} for name, work in jobs.items()}
    rows = []
    for name, work in jobs.items():
        curves[name] = {}
        for ranks in REPLAYED:
            runs = [replay(batch, ranks, LATENCY) for batch in work]
            took, busy = (sum(values) for values in zip(*runs, strict=True))
            curves[name][ranks] = busy / (ranks * took)
            values = [took, busy / took, curves[name][ranks], possible[name][ranks]]
            rows.append([name, str(ranks), *map(number, values)])
    reached = curves["identification, 8 patches"][AT]
    part.goals.append(Goal(f"efficiency of an identification replayed on {AT} ranks", REPLAYED_EFFICIENT, reached))
    tasks = [len(batch) for batch in batches]
    part.data["replay"] = {"efficiency": curves, "batches": tasks, "latency_s": LATENCY}
    part.tables.append(BenchTable("replay: measured durations, dealt out to more ranks", REPLAY_COLUMNS, rows))
    part.notes.append(
        f"replay: the identification has {len(tasks)} batches of {min(tasks)} to {max(tasks)} sets, and each waits for its "
        f"longest; the {MANY} durations of 12 patches are drawn from those of its largest batch"
    )
    wanted = AT, REPLAYED_EFFICIENT
    replay_growth(session.folder / "growth-replay.png", curves, possible, wanted, part, size=(4.6, 3.6))
