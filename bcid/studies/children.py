"""Child processes under supervision: a time limit for each, and none left behind, however this process ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from bcid.forms.mesh import child_environment

# What a child said last is told when it died.
_LAST_LINES = 3
_POLL = 0.05
# A child that does not use its CPU seconds is waited for so many times the limit.
_PATIENCE = 4.0


@dataclass(frozen=True)
class Task:
    """Something for a child to do: the arguments of a Python process, and the file for what it says."""

    name: str
    arguments: tuple[str, ...]
    log: Path


@dataclass(frozen=True)
class Ended:
    """How a child ended: "done", "failed" or "timeout", and why."""

    state: str
    reason: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class _Child:
    task: Task
    process: subprocess.Popen[bytes]
    began: float


def supervise(tasks: Sequence[Task], jobs: int, limit: float, ended: Callable[[Task, Ended], None]) -> None:
    """Run every task in a process of its own, `jobs` at a time; `ended` is called as each ends.

    A child that uses more than `limit` CPU seconds is killed, so that what else runs on the machine changes no outcome; so is
    one that takes `_PATIENCE` times as long without. SIGINT and SIGTERM kill all and raise `KeyboardInterrupt`; when
    this process is killed the children notice and end themselves (see `end_with_parent`).
    """
    waiting, running = list(reversed(tasks)), list[_Child]()
    with _interruptible():
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    running.append(_start(waiting.pop()))
                for child in list(running):
                    outcome = _outcome(child, limit)
                    if outcome is not None:
                        running.remove(child)
                        ended(child.task, outcome)
                time.sleep(_POLL)
        finally:
            for child in running:
                _kill(child)


def _start(task: Task) -> _Child:
    task.log.parent.mkdir(parents=True, exist_ok=True)
    environment = child_environment() | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with task.log.open("wb") as log:
        # A session of its own, so that its own children can be killed with it; the pipe tells it that this process lives.
        process = subprocess.Popen(
            [sys.executable, *task.arguments],
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=log,
            env=environment,
            start_new_session=True,
        )
    return _Child(task, process, time.monotonic())


def _outcome(child: _Child, limit: float) -> Ended | None:
    code, seconds = child.process.poll(), time.monotonic() - child.began
    over = code is None and _cpu_seconds(child.process.pid) > limit
    if code is None and not over and seconds < _PATIENCE * limit:
        return None
    _kill(child)
    if code is None:
        text = f"took more than {limit:.0f} CPU s" if over else f"was not done after {_PATIENCE * limit:.0f} s"
        return Ended("timeout", text, seconds)
    if code == 0:
        return Ended("done", "", seconds)
    lines = child.task.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    died = f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
    return Ended("failed", "; ".join([f"the process {died}", *lines[-_LAST_LINES:]]), seconds)


def _cpu_seconds(process: int) -> float:
    """CPU seconds of a process, and of those that it has started and waited for; 0 where that cannot be told."""
    try:
        # The name of the program, in brackets, may hold spaces: what follows it are numbers.
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def _kill(child: _Child) -> None:
    """End the child with all it has started."""
    with suppress(ProcessLookupError):
        os.killpg(child.process.pid, signal.SIGKILL)
    child.process.wait()
    if child.process.stdin:
        child.process.stdin.close()


@contextmanager
def _interruptible() -> Iterator[None]:
    """SIGTERM interrupts as Ctrl-C does."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def end_with_parent() -> None:
    """For a child of `supervise`: end this process, and all it has started, when the parent is gone."""

    def wait() -> None:
        # Nobody writes: this returns when the parent's end of the pipe is closed.
        os.read(0, 1)
        os.killpg(os.getpgid(0), signal.SIGKILL)

    threading.Thread(target=wait, daemon=True).start()
