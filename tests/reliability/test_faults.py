"""Faults of disk, memory, solver and processes, reduced; docs/reliability.md has the full sizes."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from bcid.app import answer_parsers
from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from validation.reliability import Reached, disk, kills, signals, solver, temporary


def met(found: Reached) -> None:
    assert found.met, "\n".join([found.reached, *found.misses[:10]])


def test_a_temporary_folder_that_cannot_be_used() -> None:
    met(temporary.full((1, 2), [case for case in temporary.CASES if case[0] == "16k" or case[1] != "small"]))


def test_every_fault_of_the_solver_has_a_name() -> None:
    met(solver.faulty(1))


def test_an_interrupted_job_goes_on() -> None:
    met(signals.signals(1, seed=1, ranks=(1,)))


def test_a_hanging_trial_ends() -> None:
    met(kills.hanging(1.0))


def test_workers_that_die_lose_nothing() -> None:
    met(kills.workers_die(20))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_when_everything_dies_the_rest_is_made(number: int) -> None:
    met(kills.all_die(4, seed=int(number), number=number))


def test_short_memory_is_told_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def short(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(answer_parsers, "identify", short)
    words = ["identify", "scene.toml", "seen", "-o", str(tmp_path / "run")]
    code, said = disk.command(*words)
    assert code == 3
    assert "out_of_memory" in said
    assert len(said.splitlines()) == 1


def test_a_run_whose_first_write_failed_can_be_begun_again(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run/.run.json.partial").write_text("{", encoding="utf-8")
    (tmp_path / "run/.lock").write_text("process 1 on moon", encoding="utf-8")
    run = RunFolder.start(tmp_path / "run", "identify", {})
    with pytest.raises(InputError, match="is being written by process"):
        RunFolder.start(tmp_path / "run", "identify", {})
    run.finish({})
