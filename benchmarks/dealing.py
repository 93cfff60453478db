"""What it costs to deal out the trials of a study: ``python benchmarks/dealing.py``.

10,000 trials that sleep for about 0.3 s are dealt to 48 ranks, and then to 48 child processes; asleep, they leave the cores to
the dealing. Overhead is what the whole takes beyond a replay of the trials, each as long as it was (a machine may wake a process
late), that costs nothing. Then trials of no length tell what one
costs who hands them out, and a replay with that cost tells what 1024 ranks would feel.
"""

from __future__ import annotations

import argparse
import heapq
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bcid.progress import Silent
from bcid.studies.deal import How, Work, deal, read_result

PROJECT = Path(__file__).resolve().parents[1]
GOAL = 0.01


def maker(_job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that makes a trial: it sleeps."""

    def trial(task: Mapping[str, Any]) -> dict[str, Any]:
        time.sleep(task["seconds"])
        return {}

    return trial


def tasks(count: int, shortest: float, longest: float) -> dict[str, dict[str, float]]:
    """Trials of random lengths, s; the same ones every time."""
    draw = random.Random(0)
    return {f"{i:05d}": {"seconds": draw.uniform(shortest, longest)} for i in range(count)}


def timed(folder: Path, count: int, lengths: tuple[float, float], how: How) -> tuple[float, float]:
    """Seconds that dealing out takes, without the start of those who work (Python and its packages, once for each), and that it
    would take if it cost nothing.
    """
    work = Work("benchmarks.dealing:maker", {}, folder / "results")
    workers = how.comm.size - 1 if how.comm else how.jobs
    began = time.perf_counter()
    # One short trial for each wakes everyone up: child processes are started anew, ranks are not.
    deal(work, {f"start{i}": {"seconds": 0.5} for i in range(workers)}, how, Silent())
    started = 0.0 if how.comm else time.perf_counter() - began - 0.5
    began = time.perf_counter()
    todo = tasks(count, *lengths)
    deal(work, todo, how, Silent())
    taken = time.perf_counter() - began - started
    if how.comm and how.comm.rank > 0:
        return taken, taken
    return taken, replay([float(read_result(work.file(name))["seconds"]) for name in todo], workers, 0.0)


def on_ranks(folder: Path, workers: int, count: int, lengths: tuple[float, float]) -> tuple[float, float]:
    """The same under mpirun."""
    command = ["mpirun", "-n", str(workers + 1), sys.executable, "-m", "benchmarks.dealing", "--ranks", str(folder)]
    environment = os.environ | {"PYTHONPATH": str(PROJECT)}
    said = subprocess.run(
        [*command, json.dumps([count, *lengths])], env=environment, check=True, capture_output=True, text=True
    )
    taken, ideal = map(float, said.stdout.split()[-2:])
    return taken, ideal


def replay(durations: Sequence[float], workers: int, cost: float) -> float:
    """Seconds until all is done when one process hands out trials, one after the other, at a cost of `cost` s each."""
    free = [(0.0, worker) for worker in range(workers)]
    served = end = 0.0
    for duration in durations:
        asked, worker = heapq.heappop(free)
        served = max(served, asked) + cost
        end = max(end, served + duration)
        heapq.heappush(free, (served + duration, worker))
    return end


def main() -> int:
    """Measure and print; 1 when the goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000, help="trials")
    parser.add_argument("--workers", type=int, default=48, help="ranks that work, and child processes")
    parser.add_argument("--mean", type=float, default=0.3, help="mean length of a trial, s; they vary by a third")
    parser.add_argument("--ranks", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.ranks:
        from mpi4py import MPI

        count, *lengths = json.loads(given.ranks[1])
        taken, ideal = timed(Path(given.ranks[0]), count, (lengths[0], lengths[1]), How(MPI.COMM_WORLD))
        if MPI.COMM_WORLD.rank == 0:
            print(taken, ideal, flush=True)
        return 0
    lengths = given.mean * 2 / 3, given.mean * 4 / 3
    worst = 0.0
    print(f"{given.count} trials of {lengths[0]:.2g} to {lengths[1]:.2g} s, {given.workers} workers")
    with tempfile.TemporaryDirectory() as folder:
        for name, (taken, ideal) in (
            ("ranks", on_ranks(Path(folder) / "ranks", given.workers, given.count, lengths)),
            ("children", timed(Path(folder) / "children", given.count, lengths, How(jobs=given.workers))),
        ):
            worst = max(worst, taken / ideal - 1)
            print(
                f"  {name:9} {taken:8.2f} s, {ideal:.2f} s if it cost nothing: overhead {100 * (taken / ideal - 1):5.2f} %"
            )
        none = on_ranks(Path(folder) / "none", 1, 2000, (0.0, 0.0))[0] / 2000
    print(f"a trial of no length takes one rank {1e3 * none:.2f} ms, its result included")
    for length in (1.0, 10.0, 60.0):
        durations = [length * task["seconds"] / given.mean for task in tasks(given.count, *lengths).values()]
        slower = replay(durations, 1023, none) / replay(durations, 1023, 0.0) - 1
        print(f"  replayed to 1024 ranks, trials of {length:3.0f} s: overhead {100 * slower:5.2f} %")
    print(f"goal 1 %: {'met' if worst < GOAL else 'missed'}")
    return int(worst >= GOAL)


if __name__ == "__main__":
    sys.exit(main())
