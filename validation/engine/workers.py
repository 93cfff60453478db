"""Child processes that make trials under supervision: a time limit for each trial, none left behind, each that dies replaced.

A worker takes tasks from its standard input, one line each, and answers each on a pipe of its own. When this process ends,
however it ends, that input ends, and the worker ends itself with all it has started.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from bcid.base.answering import send
from bcid.base.errors import MachineError
from bcid.base.shipped import IMPORT_ROOT
from validation.engine.time_limit import PATIENCE, never_done, used_up
from validation.engine.work import Task, Work, Workers

# What a worker said last is told when it died.
_LAST_LINES = 3
# Seconds between two looks at the time limits.
_POLL = 0.25


@dataclass
class _Worker:
    process: subprocess.Popen[bytes]
    answers: int
    log: Path
    name: str = ""
    began: float = 0.0
    cpu: float = 0.0
    unread: bytes = field(default=b"")

    def give(self, name: str, task: Task) -> None:
        """Hand it the next task."""
        self.name, self.began, self.cpu = name, time.monotonic(), _cpu_seconds(self.process.pid)
        assert self.process.stdin
        # One that has died meanwhile is noticed by its answers.
        with suppress(OSError):
            send(self.process.stdin.fileno(), json.dumps([name, dict(task)]).encode() + b"\n")

    def last_words(self) -> list[str]:
        """What it said last."""
        if not self.log.is_file():
            return []
        lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return [line.strip() for line in lines[-_LAST_LINES:]]


def supervise(work: Work, tasks: Mapping[str, Task], how: Workers, told: Callable[[int], None]) -> None:
    """Make every trial in `how.jobs` child processes; `told` is called with the number done, as each ends.

    A trial that uses more than `how.limit` CPU seconds is ended, so that what else runs on the machine changes no outcome; so
    is one that takes `PATIENCE` times as long without. One whose worker dies is tried again. SIGINT and SIGTERM end all
    and raise `KeyboardInterrupt`.

    Raises:
        MachineError: a worker cannot write.
    """
    with _interruptible(), selectors.DefaultSelector() as selector:
        pool = _Pool(work, tasks, how, selector, told)
        try:
            pool.run()
        finally:
            pool.close()


class _Pool:
    """The workers, and the trials that wait."""

    def __init__(
        self,
        work: Work,
        tasks: Mapping[str, Task],
        how: Workers,
        selector: selectors.BaseSelector,
        told: Callable[[int], None],
    ) -> None:
        self.work, self.tasks, self.how, self.selector, self.told = work, tasks, how, selector, told
        self.waiting = deque(tasks)
        self.tries = dict.fromkeys(tasks, 0)
        self.done = 0
        self.workers: list[_Worker] = []

    def run(self) -> None:
        """Until nothing is left."""
        looked = time.monotonic()
        while self.waiting or self.workers:
            while self.waiting and len(self.workers) < self.how.jobs:
                self.start()
            for key, _ in self.selector.select(_POLL):
                self.hear(key.data)
            # Not after each answer: with many workers the looks would cost more than the dealing.
            if time.monotonic() - looked >= _POLL:
                looked = time.monotonic()
                for worker in list(self.workers):
                    self.look(worker)

    def start(self) -> None:
        """Start a worker with the first trial that waits."""
        name = self.waiting.popleft()
        log = self.work.results.parent / "logs" / f"{name}.txt"
        log.parent.mkdir(parents=True, exist_ok=True)
        answers, end = os.pipe()
        environment = _environment() | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        with log.open("ab") as stream:
            # A session of its own, so that its own children can be killed with it.
            process = subprocess.Popen(
                [sys.executable, "-m", "validation.engine.worker", str(end)],
                stdin=subprocess.PIPE,
                stdout=stream,
                stderr=stream,
                env=environment,
                pass_fds=[end],
                start_new_session=True,
            )
        os.close(end)
        worker = _Worker(process, answers, log)
        self.workers.append(worker)
        self.selector.register(answers, selectors.EVENT_READ, worker)
        assert process.stdin
        with suppress(OSError):
            about = asdict(self.work) | {"results": str(self.work.results), "job": dict(self.work.job)}
            send(process.stdin.fileno(), json.dumps(about).encode() + b"\n")
        self.tries[name] += 1
        worker.give(name, self.tasks[name])

    def hear(self, worker: _Worker) -> None:
        """Take an answer, and give the next task; or note that the worker is gone."""
        said = os.read(worker.answers, 65536)
        worker.unread += said
        while b"\n" in worker.unread:
            line, _, worker.unread = worker.unread.partition(b"\n")
            answer = json.loads(line)
            if answer:
                raise MachineError(answer)
            self.count()
            worker.name = ""
            if self.waiting and not self.how.fresh:
                name = self.waiting.popleft()
                self.tries[name] += 1
                worker.give(name, self.tasks[name])
            else:
                self.end(worker)
                return
        if not said:
            self.lost(worker)

    def look(self, worker: _Worker) -> None:
        """End a trial that takes too long."""
        if not worker.name or worker not in self.workers:
            return
        limit, passed = self.how.limit, time.monotonic() - worker.began
        over = _cpu_seconds(worker.process.pid) - worker.cpu > limit
        if over or passed > PATIENCE * limit:
            text = used_up(limit) if over else never_done(limit)
            self.end(worker)
            self.give_up(worker.name, "timeout", text, passed)

    def lost(self, worker: _Worker) -> None:
        """A worker has died: its trial is tried again, or recorded as failed."""
        self.end(worker)
        code, name = worker.process.returncode, worker.name
        died = f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
        if self.work.file(name).is_file():
            self.count()
        elif self.tries[name] < self.how.tries:
            # Last: what kills again and again holds up no other.
            self.waiting.append(name)
        else:
            reason = "; ".join([f"its process {died}, {self.tries[name]} times", *worker.last_words()])
            self.give_up(name, "failed", reason, time.monotonic() - worker.began)

    def give_up(self, name: str, state: str, reason: str, seconds: float) -> None:
        if not self.work.file(name).is_file():
            self.work.record(name, self.tasks[name], state, reason, seconds)
        self.count()

    def count(self) -> None:
        self.done += 1
        self.told(self.done)

    def end(self, worker: _Worker) -> None:
        """End a worker with all it has started."""
        self.workers.remove(worker)
        self.selector.unregister(worker.answers)
        with suppress(ProcessLookupError):
            os.killpg(worker.process.pid, signal.SIGKILL)
        worker.process.wait()
        os.close(worker.answers)
        with suppress(OSError):
            assert worker.process.stdin
            worker.process.stdin.close()
        if worker.log.is_file() and not worker.log.stat().st_size:
            worker.log.unlink()

    def close(self) -> None:
        """End every worker."""
        for worker in list(self.workers):
            self.end(worker)


def _environment() -> dict[str, str]:
    """Without the variables that would make the child a member of this MPI job."""
    mpi = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "MPIR_")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(mpi)}
    root = str(IMPORT_ROOT)
    return kept | {"PYTHONPATH": os.pathsep.join(filter(None, [root, kept.get("PYTHONPATH", "")]))}


def _cpu_seconds(process: int) -> float:
    """CPU seconds of a process, and of those that it has started and waited for; 0 where that cannot be told."""
    try:
        # The name of the program, in brackets, may hold spaces: what follows it are numbers.
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _interruptible() -> Iterator[None]:
    """SIGTERM interrupts as Ctrl-C does; a worker that is gone is not a signal, as PETSc makes it where it is loaded."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    wanted: dict[signal.Signals, Any] = {
        signal.SIGINT: interrupt,
        signal.SIGTERM: interrupt,
        signal.SIGPIPE: signal.SIG_IGN,
    }
    before = {number: signal.signal(number, handler) for number, handler in wanted.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
