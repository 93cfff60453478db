"""Deals out the trials of a study: under mpirun to the ranks, by mpi4py.futures; else to child processes under supervision.

A trial is a name and a task, a JSON object. Its result is one file, `results/NAME.json`, written whole and renamed: what is
there is not made again, so a study that was killed, in whatever way, goes on with the rest. A trial that goes wrong is
recorded with its reason and stops nothing; only a machine that cannot write ends the study.
"""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache, partial
from importlib import import_module
from itertools import chain
from typing import Any

from bcid.base.collective import Comm, agree, on_root
from bcid.base.errors import BcidError, MachineError
from bcid.base.progress import Progress
from validation.engine.time_limit import OutOfTime, limited
from validation.engine.work import Make, Task, Work, Workers
from validation.engine.workers import supervise

# Ranks are handed so many trials at once that each comes back about this often, and never more than the most; at the end,
# lest some wait for the others, so many times as many one by one.
_RETURNS, _MOST, _LAST = 20, 8, 2


def dispatch(work: Work, tasks: Mapping[str, Task], how: Workers, progress: Progress) -> int:
    """Make all trials that have no result yet; collective on `how.comm`. Returns how many were made.

    Raises:
        MachineError: a result could not be written.
        KeyboardInterrupt: SIGINT or SIGTERM; the children are gone then.
    """
    todo = on_root(
        how.comm, lambda: {name: dict(task) for name, task in tasks.items() if not work.file(name).is_file()}
    )
    if len(todo) < len(tasks):
        progress.say(f"{len(tasks) - len(todo)} of {len(tasks)} trials are done already")
    if how.comm is not None:
        _among_ranks(how.comm, work, todo, how.limit, progress)
    elif todo:
        supervise(work, todo, how, partial(_tell, progress, len(todo)))
    return len(todo)


def _tell(progress: Progress, count: int, done: int) -> None:
    progress.step("trials", done, count)


def _among_ranks(comm: Comm, work: Work, todo: Mapping[str, Task], limit: float, progress: Progress) -> None:
    """Rank 0 hands out, the others make; they ask for the next when they are done. Collective on `comm`."""
    from mpi4py.futures import MPICommExecutor

    # PETSc starts on all ranks of the job together: a trial that were the first to need it would wait for rank 0, which makes none.
    with suppress(ImportError):
        import_module("petsc4py.PETSc")
    error: BcidError | None = None
    with MPICommExecutor(comm, root=0) as pool:
        executor: Any = pool
        if executor is not None:
            made = [
                executor.map(
                    partial(attempt, work, limit=limit), *zip(*part, strict=True), chunksize=size, unordered=True
                )
                for part, size in portions(list(todo.items()), comm.size - 1)
            ]
            try:
                for done, _ in enumerate(chain.from_iterable(made), start=1):
                    _tell(progress, len(todo), done)
            except BcidError as caught:
                error = caught
                executor.shutdown(wait=False, cancel_futures=True)
    agree(comm, error)


def portions(todo: list[Any], workers: int) -> list[tuple[list[Any], int]]:
    """What is handed out in which order, and how much of it at once."""
    size = max(1, min(_MOST, len(todo) // (_RETURNS * workers)))
    many = len(todo) - _LAST * size * workers if size > 1 else 0
    return [(part, at_once) for part, at_once in ((todo[:many], size), (todo[many:], 1)) if part]


def attempt(work: Work, name: str, task: Task, limit: float | None = None) -> None:
    """Make a trial and write its result; what goes wrong with it is a result too.

    Args:
        work: what makes trials.
        name: of the trial.
        task: what is to be made.
        limit: CPU seconds that it may take; None where someone else looks at them.

    Raises:
        MachineError: the result cannot be written.
    """
    if work.file(name).is_file():
        return
    start = time.perf_counter()
    result, state, reason = None, "done", ""
    try:
        with limited(limit):
            result = _make(work.maker, json.dumps(work.job, sort_keys=True))(task)
        # A number that is not finite is not JSON.
        json.dumps(result, allow_nan=False)
    except MachineError:
        raise
    except OutOfTime as error:
        result, state, reason = None, "timeout", str(error)
        # It ended anywhere: what it shares with other trials is made anew for them.
        _make.cache_clear()
    except Exception as error:
        result, state, reason = None, "failed", str(error)
        if not isinstance(error, BcidError):
            traceback.print_exc()
            reason = f"{type(error).__name__}: {error}"
    work.record(name, task, state, reason, time.perf_counter() - start, result)


@lru_cache(maxsize=1)
def _make(maker: str, job: str) -> Make:
    """The function that makes trials, made once per process."""
    module, _, name = maker.partition(":")
    made: Make = getattr(import_module(module), name)(json.loads(job))
    return made


def part_of(tasks: Mapping[str, Task], part: tuple[int, int] | None) -> dict[str, Task]:
    """The tasks of part (i, n), i from 1 to n: every n-th, so that the parts take about as long."""
    if part is None:
        return dict(tasks)
    i, n = part
    return {name: task for k, (name, task) in enumerate(tasks.items()) if k % n == i - 1}
