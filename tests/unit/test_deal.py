"""Dealing out trials: every one is accounted for, whatever dies."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from bcid.errors import InputError, MachineError
from bcid.progress import Silent
from bcid.studies.deal import How, Work, attempt, deal, part_of, read_result

HERE = Path(__file__).resolve().parent


@pytest.fixture(autouse=True)
def _found_by_children(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(HERE))


def work(folder: Path, **job: Any) -> Work:
    folder.mkdir(exist_ok=True)
    return Work("made_up_trials:maker", {"calls": str(folder / "calls.txt"), **job}, folder / "results")


def tasks(count: int, **faults: str) -> dict[str, dict[str, Any]]:
    return {f"{i:04d}": {"index": i, "fault": faults.get(f"t{i}", "")} for i in range(count)}


def read(made: Work, index: int) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(made.file(f"{index:04d}").read_text(encoding="utf-8"))
    return content


def begun(made: Work) -> list[int]:
    calls = Path(made.job["calls"])
    lines = calls.read_text(encoding="utf-8").splitlines() if calls.is_file() else []
    return [int(line.split()[0]) for line in lines]


@pytest.mark.timeout(120)
def test_every_trial_ends_with_a_result_or_a_reason(tmp_path: Path) -> None:
    made = work(tmp_path)
    faults = {"t1": "raise", "t3": "abort", "t4": "segv", "t5": "exit", "t6": "solve", "t7": "nan", "t8": "hang"}
    deal(made, tasks(12, **faults, t9="spin"), How(jobs=2, limit=2.0, tries=3), Silent())
    assert [read(made, i)["state"] for i in (0, 2, 10, 11)] == ["done"] * 4
    assert read(made, 11)["result"] == {"value": 121}
    assert read(made, 11)["task"] == {"index": 11, "fault": ""}
    reasons = {i: read(made, i)["reason"] for i in range(12)}
    assert reasons[1] == "ValueError: no such thing"
    assert reasons[6] == "no equilibrium"
    assert "signal 6, 3 times" in reasons[3]
    assert "signal 11, 3 times" in reasons[4]
    assert "ended with code 7, 3 times" in reasons[5]
    assert reasons[7].startswith("ValueError")
    assert (reasons[8], read(made, 8)["state"]) == ("was not done after 8 s", "timeout")
    assert (reasons[9], read(made, 9)["state"]) == ("took more than 2 CPU s", "timeout")
    # What died is tried again; what raised is not.
    assert [begun(made).count(i) for i in (0, 1, 3, 4, 5, 8, 9)] == [1, 1, 3, 3, 3, 1, 1]
    # Workers are kept: a new one only for each that was lost.
    assert len({line.split()[1] for line in Path(made.job["calls"]).read_text().splitlines()}) <= 2 + 9 + 2


@pytest.mark.timeout(120)
def test_workers_that_are_killed_lose_nothing(tmp_path: Path) -> None:
    """F1, reduced: SIGKILL and SIGSEGV from outside, at random moments; the table is that of an undisturbed study."""
    made, every = work(tmp_path, sleep=0.05), tasks(60)
    killed = subprocess.Popen([sys.executable, "-c", _KILLER, made.job["calls"], "20"])
    deal(made, every, How(jobs=2), Silent())
    killed.kill()
    assert [read(made, i)["result"]["value"] for i in range(60)] == [i * i for i in range(60)]
    assert len(begun(made)) > 60


# Kills whoever has begun a trial last.
_KILLER = """
import os, random, signal, sys, time
draw = random.Random(1)
left = int(sys.argv[2])
while left:
    time.sleep(draw.uniform(0.02, 0.15))
    try:
        worker = int(open(sys.argv[1]).read().splitlines()[-1].split()[1])
        os.kill(worker, draw.choice([signal.SIGKILL, signal.SIGSEGV]))
        left -= 1
    except (OSError, IndexError, ValueError):
        pass
"""


@pytest.mark.timeout(120)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_when_everything_dies_the_rest_is_made(tmp_path: Path, number: int) -> None:
    """F2, reduced: the parent is killed at any moment, its workers end themselves, and nothing is made twice."""
    made, every = work(tmp_path, sleep=0.05), tasks(40)
    draw = random.Random(int(number))
    done: set[str] = set()
    for _ in range(4):
        parent = subprocess.Popen([sys.executable, "-c", _PARENT, str(tmp_path)], stderr=subprocess.DEVNULL)
        begun_before, end = len(begun(made)), time.monotonic() + 60
        while len(begun(made)) == begun_before:
            assert time.monotonic() < end
            time.sleep(0.01)
        time.sleep(draw.uniform(0.0, 0.3))
        parent.send_signal(number)
        parent.wait(timeout=10)
        _no_one_left(made)
        now = {file.stem for file in made.results.glob("0*.json")}
        assert done <= now
        done = now
    kept = {name: made.file(name).read_bytes() for name in done}
    before = len(begun(made))
    deal(made, every, How(), Silent())
    assert all(made.file(name).read_bytes() == content for name, content in kept.items())
    assert len(begun(made)) - before == len(every) - len(done)
    assert [read(made, i)["result"]["value"] for i in range(40)] == [i * i for i in range(40)]


_PARENT = """
import sys
from pathlib import Path
from test_deal import How, Silent, deal, tasks, work
deal(work(Path(sys.argv[1]), sleep=0.05), tasks(40), How(), Silent())
"""


def _no_one_left(made: Work, seconds: float = 10.0) -> None:
    """Wait until no worker that has ever begun a trial is alive."""
    end = time.monotonic() + seconds
    for line in Path(made.job["calls"]).read_text(encoding="utf-8").splitlines():
        while _alive(int(line.split()[1])):
            assert time.monotonic() < end
            time.sleep(0.05)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_what_cannot_be_written_ends_the_study(tmp_path: Path) -> None:
    made = work(tmp_path)
    made.results.write_text("a file where the folder should be", encoding="utf-8")
    with pytest.raises(MachineError, match="cannot be written"):
        attempt(made, "0000", {"index": 0})
    with pytest.raises(MachineError, match="cannot be written"):
        deal(made, tasks(3), How(jobs=1), Silent())


def test_a_result_that_is_damaged_is_named(tmp_path: Path) -> None:
    made = work(tmp_path)
    attempt(made, "0003", {"index": 3, "fault": ""})
    file = made.file("0003")
    whole = file.read_bytes()
    assert read_result(file)["result"] == {"value": 9}
    for damaged in (whole[:-9], whole.replace(b'"value": 9', b'"value": 8'), b"", b"[]", b"\xff"):
        file.write_bytes(damaged)
        with pytest.raises(InputError, match=r"0003.json: is missing or damaged \(.*; remove it, it is made again"):
            read_result(file)


def test_parts_are_all_and_none_twice() -> None:
    every = tasks(17)
    parts = [part_of(every, (i, 5)) for i in range(1, 6)]
    assert sorted(name for part in parts for name in part) == sorted(every)
    assert {len(part) for part in parts} == {3, 4}
    assert part_of(every, None) == every
