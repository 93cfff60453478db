"""F1, F2 and F4-hanging: workers die, everything dies, or a trial hangs; every trial of a study is accounted for."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from bcid.base.progress import Silent
from validation.engine.dispatch import dispatch
from validation.engine.work import Work, Workers, read_result
from validation.reliability import ROOT, Reached

# Seconds that a trial takes.
_LONG = 0.05
_WAIT = 60.0
# Kills whoever has begun a trial last, at random moments.
_KILLER = """
import os, random, signal, sys, time
draw, left, last = random.Random(int(sys.argv[3])), int(sys.argv[2]), ""
while left:
    time.sleep(draw.uniform(0.01, 0.1))
    try:
        line = open(sys.argv[1]).read().splitlines()[-1]
        if line != last:
            os.kill(int(line.split()[1]), draw.choice([signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT]))
            left, last = left - 1, line
    except (OSError, IndexError, ValueError):
        pass
"""
# A study of its own, to be killed as a whole.
_PARENT = """
import sys
from pathlib import Path
from validation.engine.dispatch import dispatch
from validation.engine.work import Workers
from bcid.base.progress import Silent
from validation.reliability.kills import tasks, work
dispatch(work(Path(sys.argv[1]), sleep=float(sys.argv[3])), tasks(int(sys.argv[2])), Workers(), Silent())
"""


def work(folder: Path, **job: Any) -> Work:
    """Trials that are made up; who has begun which is noted in `folder`/calls.txt."""
    folder.mkdir(exist_ok=True)
    calls = str(folder / "calls.txt")
    return Work("validation.reliability.made_up_trials:maker", {"calls": calls, **job}, folder / "results")


def tasks(count: int, **faults: str) -> dict[str, dict[str, Any]]:
    """So many trials; `t3="abort"` is the fault of the third."""
    return {f"{i:04d}": {"index": i, "fault": faults.get(f"t{i}", "")} for i in range(count)}


def begun(made: Work) -> list[tuple[int, int]]:
    """Trials that were begun, with the process that did, in order."""
    calls = Path(made.job["calls"])
    lines = calls.read_text(encoding="utf-8").splitlines() if calls.is_file() else []
    return [(int(line.split()[0]), int(line.split()[1])) for line in lines]


def values(made: Work, count: int) -> list[int | None]:
    """The results of all trials; None for one that has none."""
    found = []
    for i in range(count):
        file = made.file(f"{i:04d}")
        result = read_result(file)["result"] if file.is_file() else None
        found.append(result["value"] if result else None)
    return found


def no_one_left(made: Work, seconds: float = 10.0) -> bool:
    """Wait until no process that has ever begun a trial is alive."""
    end = time.monotonic() + seconds
    for _, process in begun(made):
        while alive(process):
            if time.monotonic() > end:
                return False
            time.sleep(0.05)
    return True


def alive(process: int) -> bool:
    """Whether a process is there."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def workers_die(count: int = 200, seed: int = 0) -> Reached:
    """F1: so many kills of workers (SIGKILL, SIGSEGV, SIGABRT) during a study of 500 trials, or of 2.5 times as many as kills."""
    trials = max(20, count * 5 // 2)
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        made = work(Path(name) / "study", sleep=_LONG)
        killer = subprocess.Popen([sys.executable, "-c", _KILLER, made.job["calls"], str(count), str(seed)])
        try:
            dispatch(made, tasks(trials), Workers(jobs=2), Silent())
        finally:
            killer.kill()
            killer.wait()
        again = len(begun(made)) - trials
        right = values(made, trials) == [i * i for i in range(trials)]
    text = (
        f"{trials} trials, {again} begun again, {'all' if right else 'NOT all'} with the result of an undisturbed study"
    )
    goal = f"{count} kills of workers during {trials} trials: every trial accounted for, same table"
    return Reached(goal, text, right and again > count // 4)


def all_die(count: int = 100, seed: int = 0, number: int = signal.SIGKILL) -> Reached:
    """F2: the whole study is killed so many times; it goes on to the end, nothing is lost and nothing is made twice."""
    draw, trials, misses = random.Random(seed), 10 * count, []
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        made = work(Path(name) / "study", sleep=_LONG)
        done: dict[str, bytes] = {}
        kills = 0
        while kills < count and len(done) < trials:
            before = len(begun(made))
            words = [sys.executable, "-c", _PARENT, str(Path(name) / "study"), str(trials), str(_LONG)]
            parent = subprocess.Popen(words, env=environment, cwd=ROOT, stderr=subprocess.DEVNULL)
            end = time.monotonic() + _WAIT
            while len(begun(made)) == before and parent.poll() is None and time.monotonic() < end:
                time.sleep(0.01)
            time.sleep(draw.uniform(0.0, 0.3))
            parent.send_signal(number)
            parent.wait()
            kills += 1
            if not no_one_left(made):
                misses.append(f"kill {kills}: a worker outlives its study by 10 s")
            now = {file.name: file.read_bytes() for file in made.results.glob("0*.json")}
            misses += [f"kill {kills}: {file} is lost or changed" for file in done if now.get(file) != done[file]]
            done = now
        before = len(begun(made))
        dispatch(made, tasks(trials), Workers(), Silent())
        twice = len(begun(made)) - before - (trials - len(done))
        if twice:
            misses.append(f"{twice} trials were made again that had a result")
        if values(made, trials) != [i * i for i in range(trials)]:
            misses.append("results differ from those of an undisturbed study")
    text = f"{kills} kills, {len(done)} of {trials} trials done by then, the rest in one go"
    return Reached(f"{count} kills of the whole study: nothing lost, nothing twice", text, not misses, tuple(misses))


def hanging(limit: float = 2.0) -> Reached:
    """F4: a trial that computes for ever, or waits for ever, is ended by its limit, and its neighbours are done."""
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        made = work(Path(name) / "study")
        start = time.monotonic()
        dispatch(made, tasks(4, t1="spin", t2="hang"), Workers(limit=limit), Silent())
        seconds = time.monotonic() - start
        states = [json.loads(made.file(f"{i:04d}").read_text(encoding="utf-8"))["state"] for i in range(4)]
        left = not no_one_left(made)
    text = f"states {', '.join(states)}, in {seconds:.0f} s" + ("; a process is left" if left else "")
    met = states == ["done", "timeout", "timeout", "done"] and not left
    return Reached("a hanging trial ends at its limit, the others are done", text, met)
