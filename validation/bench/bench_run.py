"""`bcid-validate bench`: runs the parts, prints their tables, and writes bench.json and the plots. See docs/bench.md."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bcid.base.errors import InputError, MachineError, nearest
from bcid.base.progress import Lines, Progress
from bcid.base.run_folder import write_whole
from bcid.base.version import VERSION
from validation.bench import (
    explain_bench,
    explore_bench,
    growth_bench,
    identification_bench,
    toggles_bench,
    trajectory_bench,
)
from validation.bench.bench_table import Part, goals_table
from validation.bench.measure import Session

_MEASURES: dict[str, Callable[[Session], Part]] = {
    "trajectory": trajectory_bench.run,
    "toggles": toggles_bench.run,
    "identification": identification_bench.run,
    "explain": explain_bench.run,
    "explore": explore_bench.run,
    "growth": growth_bench.run,
}
PARTS = tuple(_MEASURES)
FORMAT = "bcid-bench/1"


def run(names: Sequence[str], folder: Path, quick: bool = False, progress: Progress | None = None) -> dict[str, Part]:
    """Run parts of the benchmark, all by default; print their tables and write the output folder.

    Raises:
        InputError: there is no part of that name, or this is a rank of an MPI job.
        MachineError: the folder cannot be written, or what is to be measured cannot be run.
    """
    for name in names:
        if name not in PARTS:
            raise InputError(f"bench has no part '{name}'; {nearest(name, PARTS)}")
    if int(os.environ.get("OMPI_COMM_WORLD_SIZE", os.environ.get("PMI_SIZE", "1"))) > 1:
        raise InputError("bench starts its own ranks: run it without mpirun")
    try:
        folder = folder.resolve()
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "bench.json").unlink(missing_ok=True)
    except OSError as error:
        raise MachineError(f"{folder}: cannot be written: {error.strerror}") from None
    session = Session(folder, quick, progress or Lines())
    start = time.perf_counter()
    found: dict[str, Part] = {}
    for name in [part for part in PARTS if part in names or not names]:
        begin = time.perf_counter()
        found[name] = _MEASURES[name](session)
        found[name].data["seconds"] = time.perf_counter() - begin
        print(found[name].text(), end="\n\n", flush=True)
        _write(folder, found, quick, time.perf_counter() - start)
    print(_summary(found, time.perf_counter() - start, folder))
    return found


def _summary(found: dict[str, Part], seconds: float, folder: Path) -> str:
    goals = [goal for part in found.values() for goal in part.goals]
    missed = [goal for goal in goals if goal.met is not True]
    met = len(goals) - len(missed)
    text = f"{met} of {len(goals)} goals met, in {seconds:.0f} s; {folder / 'bench.json'}"
    if missed:
        text = f"{goals_table(missed).text().replace('goals', 'goals that were missed or not measured', 1)}\n{text}"
    return text


def _write(folder: Path, found: dict[str, Part], quick: bool, seconds: float) -> None:
    content = {
        "format": FORMAT,
        "bcid": VERSION,
        "machine": machine(),
        "quick": quick,
        "seconds": seconds,
        "parts": {name: part.to_json() for name, part in found.items()},
    }
    write_whole(folder / "bench.json", json.dumps(content, indent=1, default=float) + "\n")


def machine() -> dict[str, Any]:
    """What it was measured on."""
    cpu = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        cpu = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {"cpu": cpu, "cores": len(os.sched_getaffinity(0)), "python": sys.version.split()[0]}
