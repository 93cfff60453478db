"""Dealing out trials: every one is accounted for, whatever dies."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from bcid.base.errors import InputError, MachineError
from bcid.base.progress import Silent
from validation.engine.dispatch import attempt, dispatch, part_of, portions
from validation.engine.work import Task, Work, Workers, read_result
from validation.engine.workers import _Worker
from validation.reliability.kills import begun, tasks, work


def read(made: Work, index: int) -> dict[str, Any]:
    return read_result(made.file(f"{index:04d}"))


@pytest.mark.timeout(120)
def test_every_trial_ends_with_a_result_or_a_reason(tmp_path: Path) -> None:
    made = work(tmp_path)
    faults = {"t1": "raise", "t3": "abort", "t4": "segv", "t5": "exit", "t6": "solve", "t7": "nan", "t8": "hang"}
    dispatch(made, tasks(12, **faults, t9="spin"), Workers(jobs=2, limit=2.0, tries=3), Silent())
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
    trials = [index for index, _ in begun(made)]
    assert [trials.count(i) for i in (0, 1, 3, 4, 5, 8, 9)] == [1, 1, 3, 3, 3, 1, 1]
    # Workers are kept: a new one only for each that was lost.
    assert len({process for _, process in begun(made)}) <= 2 + 9 + 2


@pytest.mark.parametrize(
    ("count", "workers"), [(0, 2), (1, 5), (39, 1), (40, 1), (333, 2), (10_000, 48), (10_000, 1023)]
)
def test_ranks_get_many_short_trials_at_once_and_the_last_one_by_one(count: int, workers: int) -> None:
    handed = portions(list(range(count)), workers)
    assert [one for part, _ in handed for one in part] == list(range(count))
    sizes = [size for _, size in handed]
    assert sizes == sorted(sizes, reverse=True)
    if count:
        part, size = handed[-1]
        # Who has just got many has them done before the last are gone.
        assert size == 1
        assert len(part) == count or len(part) == 2 * sizes[0] * workers
        assert sizes[0] * 20 * workers <= max(count, 20 * workers)


def test_what_cannot_be_written_ends_the_study(tmp_path: Path) -> None:
    made = work(tmp_path)
    made.results.write_text("a file where the folder should be", encoding="utf-8")
    with pytest.raises(MachineError, match="cannot be written"):
        attempt(made, "0000", {"index": 0})
    with pytest.raises(MachineError, match="cannot be written"):
        dispatch(made, tasks(3), Workers(jobs=1), Silent())


def test_a_worker_that_is_gone_is_no_signal(tmp_path: Path) -> None:
    """PETSc, once loaded, ends the process at a broken pipe."""
    before = signal.signal(signal.SIGPIPE, lambda *_: pytest.fail("a broken pipe was signalled"))
    given = _Worker.give

    def give(worker: _Worker, name: str, task: Task) -> None:
        worker.process.kill()
        worker.process.wait()
        given(worker, name, task)

    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_Worker, "give", give)
            dispatch(work(tmp_path), tasks(2), Workers(jobs=1, tries=2), Silent())
        assert signal.getsignal(signal.SIGPIPE) is not signal.SIG_IGN
    finally:
        signal.signal(signal.SIGPIPE, before)
    assert "killed by signal 9, 2 times" in read(work(tmp_path), 1)["reason"]


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


SBATCH = """\
import os, re, subprocess, sys
options = [argument for argument in sys.argv[1:] if argument.startswith("--")]
known = {"parsable", "ntasks", "cpus-per-task", "mem-per-cpu", "time", "requeue", "array", "job-name", "dependency", "wrap"}
assert {re.match("--([a-z-]+)", option)[1] for option in options} <= known, options
given = dict(option[2:].split("=", 1) for option in options if "=" in option)
first, last = (int(n) for n in given["array"].split("-")) if "array" in given else (0, 0)
with open("jobs", "a") as jobs:
    print(given["job-name"], given.get("dependency", ""), file=jobs)
for index in range(first, last + 1):
    environment = os.environ | {"SLURM_ARRAY_TASK_ID": str(index)}
    subprocess.run(["sh", "-c", sys.argv[sys.argv.index("--wrap") + 1]], env=environment, check=True, stdout=sys.stderr)
print({"predict": 41, "trials": 42, "tables": 43}[given["job-name"]])
"""


def test_the_slurm_script_submits_every_part_of_a_study(tmp_path: Path) -> None:
    """With a stand-in for sbatch, which runs each task of an array at once, and one for bcid-validate, which notes its words."""
    script = Path(__file__).resolve().parents[2] / "validation/study.sh"
    for name, text in (
        ("sbatch", f"#!{sys.executable}\n{SBATCH}"),
        ("bcid-validate", '#!/bin/sh\nfor a; do printf "%s|" "$a"; done >>calls\necho >>calls\n'),
    ):
        (tmp_path / name).write_text(text, encoding="utf-8")
        (tmp_path / name).chmod(0o755)
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    command = ["sh", str(script), "my study.toml", "my run", "3"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    study = "study|my study.toml|-o|my run|"
    assert (tmp_path / "calls").read_text(encoding="utf-8").splitlines() == [
        *(f"{study}--part|{i}/3|--predict-only|--jobs|2|" for i in (1, 2, 3)),
        *(f"{study}--part|{i}/3|--jobs|2|" for i in (1, 2, 3)),
        study,
    ]
    jobs = (tmp_path / "jobs").read_text(encoding="utf-8").split("\n")
    assert jobs[:3] == ["predict ", "trials afterok:41", "tables afterok:42"]
