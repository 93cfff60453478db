"""What it costs to deal out the trials of a study: ``python -m validation.bench.dealing``.

10,000 trials that sleep for about half a second are dealt to 48 ranks, and then to 48 child processes; asleep, they leave the cores
to the dealing. Overhead is what those who work spend between their trials (writing the result of one, asking for the next) against
what they spend in them. Beginning and ending a study, once, are not in it: what ranks need for that is told apart. Then trials of
no length tell what one costs who hands them out, and a replay with that cost tells what 1024 ranks would feel.
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
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from bcid.base.progress import Silent
from validation.engine.dispatch import dispatch
from validation.engine.work import Work, Workers, read_result

PROJECT = Path(__file__).resolve().parents[1]
GOAL = 0.01


def maker(_job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that makes a trial: it sleeps."""

    def trial(task: Mapping[str, Any]) -> dict[str, Any]:
        began = time.monotonic()
        time.sleep(task["seconds"])
        return {"who": os.getpid(), "began": began, "ended": time.monotonic()}

    return trial


def tasks(count: int, shortest: float, longest: float) -> dict[str, dict[str, float]]:
    """Trials of random lengths, s; the same ones every time."""
    draw = random.Random(0)
    return {f"{i:05d}": {"seconds": draw.uniform(shortest, longest)} for i in range(count)}


class Spent(NamedTuple):
    """Seconds of those who work, all together.

    Attributes:
        within: in trials.
        between: between them.
        whole: of the study, by the clock.
        working: from the first trial's begin to the last one's end, by the clock.
    """

    within: float
    between: float
    whole: float
    working: float

    @property
    def overhead(self) -> float:
        """What is spent between trials against what is spent in them."""
        return self.between / self.within


def dealt(folder: Path, count: int, lengths: tuple[float, float], how: Workers) -> Spent:
    """Deal out trials and read from their results who made which when; on ranks other than the first all numbers are zero."""
    work = Work("validation.bench.dealing:maker", {}, folder / "results")
    todo = tasks(count, *lengths)
    if how.comm:
        # One short trial for each wakes everyone up.
        dispatch(work, {f"start{i}": {"seconds": 0.5} for i in range(how.comm.size - 1)}, how, Silent())
    began = time.monotonic()
    dispatch(work, todo, how, Silent())
    whole = time.monotonic() - began
    if how.comm and how.comm.rank > 0:
        return Spent(0.0, 0.0, 0.0, 0.0)
    made: dict[int, list[tuple[float, float]]] = {}
    for name in todo:
        result = read_result(work.file(name))["result"]
        made.setdefault(result["who"], []).append((result["began"], result["ended"]))
    trials = [sorted(own) for own in made.values()]
    within = sum(end - begin for own in trials for begin, end in own)
    between = sum(after[0] - before[1] for own in trials for before, after in pairwise(own))
    working = max(own[-1][1] for own in trials) - min(own[0][0] for own in trials)
    return Spent(within, between, whole, working)


def on_ranks(folder: Path, workers: int, count: int, lengths: tuple[float, float]) -> Spent:
    """The same under mpirun."""
    command = [
        "mpirun",
        "-n",
        str(workers + 1),
        sys.executable,
        "-m",
        "validation.bench.dealing",
        "--ranks",
        str(folder),
    ]
    environment = os.environ | {"PYTHONPATH": str(PROJECT)}
    said = subprocess.run(
        [*command, json.dumps([count, *lengths])], env=environment, check=True, capture_output=True, text=True
    )
    return Spent(*json.loads(said.stdout.splitlines()[-1]))


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
    parser.add_argument("--mean", type=float, default=0.5, help="mean length of a trial, s; they vary by a third")
    parser.add_argument("--ranks", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.ranks:
        from mpi4py import MPI

        count, *lengths = json.loads(given.ranks[1])
        spent = dealt(Path(given.ranks[0]), count, (lengths[0], lengths[1]), Workers(MPI.COMM_WORLD))
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps(spent), flush=True)
        return 0
    lengths = given.mean * 2 / 3, given.mean * 4 / 3
    worst = 0.0
    print(f"{given.count} trials of {lengths[0]:.2g} to {lengths[1]:.2g} s, {given.workers} workers")
    with tempfile.TemporaryDirectory() as folder:
        for name, spent in (
            ("ranks", on_ranks(Path(folder) / "ranks", given.workers, given.count, lengths)),
            ("children", dealt(Path(folder) / "children", given.count, lengths, Workers(jobs=given.workers))),
        ):
            worst = max(worst, spent.overhead)
            each = 1e3 * spent.between / given.count
            print(
                f"  {name:9} {spent.whole:7.2f} s, {spent.whole - spent.working:.2f} s of it before and after all trials; "
                f"between trials {each:.2f} ms, overhead {100 * spent.overhead:.2f} %"
            )
        none = on_ranks(Path(folder) / "none", 1, 2000, (0.0, 0.0)).whole / 2000
    print(f"a trial of no length takes one rank {1e3 * none:.2f} ms, its result included")
    for length in (1.0, 10.0, 60.0):
        durations = [length * task["seconds"] / given.mean for task in tasks(given.count, *lengths).values()]
        slower = replay(durations, 1023, none) / replay(durations, 1023, 0.0) - 1
        print(f"  replayed to 1024 ranks, trials of {length:3.0f} s: overhead {100 * slower:5.2f} %")
    print(f"goal 1 %: {'met' if worst < GOAL else 'missed'}")
    return int(worst >= GOAL)


if __name__ == "__main__":
    sys.exit(main())
