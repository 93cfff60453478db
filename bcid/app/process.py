"""Runs the work of a command in this process, alone or on the ranks of an MPI job, and turns what went wrong into an exit code."""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from functools import partial
from typing import Any

from bcid.app.console import complain
from bcid.base.collective import Comm, first
from bcid.base.errors import SHORT_OF_MEMORY, BcidError, MachineError
from bcid.base.scratch import require

# How long the ranks that are not the first wait for it to end the job, s.
_PATIENCE = 3.0


def prepare() -> None:
    """What holds for every command, before NumPy is loaded."""
    # Ranks must not fight for cores.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # Where nobody reads what is printed, as behind "| head", PETSc would end the process with a page of its own.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})


def on_ranks(work: Callable[[Comm], None]) -> int:
    """Run work that is collective on all ranks; returns the exit code."""
    trouble = _of_the_machine()
    if trouble:
        complain(trouble)
        return trouble.exit_code
    comm = _communicator()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, partial(_interrupted, comm))
    try:
        work(comm)
        sys.stdout.flush()
        return 0
    except BcidError as error:
        if comm.rank == 0:
            complain(error)
        return error.exit_code
    except MemoryError:
        complain(SHORT_OF_MEMORY)
        return _end_all(comm, MachineError.exit_code)
    except BrokenPipeError:
        return _end_all(comm, _unread())
    except BaseException:
        traceback.print_exc()
        return _end_all(comm, 1)


def alone(work: Callable[[], None], interrupted: str, starts_jobs: bool = False) -> int:
    """Run work without MPI in this process; returns the exit code.

    Args:
        work: what to do.
        interrupted: what becomes of it when it is interrupted.
        starts_jobs: whether it starts jobs with MPI, which need a temporary folder.
    """
    try:
        if starts_jobs:
            require()
        work()
        sys.stdout.flush()
        return 0
    except KeyboardInterrupt:
        complain(f"interrupted; {interrupted}")
        return 128 + signal.SIGINT
    except MemoryError:
        complain(SHORT_OF_MEMORY)
        return MachineError.exit_code
    except BrokenPipeError:
        return _unread()
    except BcidError as error:
        complain(error)
        return error.exit_code


def _unread() -> int:
    """Stop printing where nobody reads it; returns the exit code."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 128 + signal.SIGPIPE


def _of_the_machine() -> MachineError | None:
    """What is missing before MPI can be begun: Open MPI dies of a temporary folder that is full or cannot be written."""
    try:
        require()
    except MachineError as error:
        if not first():
            # The first rank has the same to say, unless it is another machine, and ends all of them.
            time.sleep(_PATIENCE)
        return error
    return None


def _communicator() -> Any:
    try:
        from mpi4py import MPI
    except ImportError:
        complain("mpi4py and DOLFINx are not installed here; `bcid doctor` tells what is missing")
        raise SystemExit(3) from None
    return MPI.COMM_WORLD


def _interrupted(comm: Comm, number: int, _frame: object) -> None:
    """End at once: an exception inside a PETSc callback would be taken for a failed solve. Runs resume from what they kept."""
    if comm.rank == 0:
        complain("interrupted; the same command goes on where it was")
    if comm.size > 1:
        comm.Abort(128 + number)
    os._exit(128 + number)


def _end_all(comm: Comm, code: int) -> int:
    """An error on one rank must not leave the others waiting for it."""
    if comm.size > 1:
        sys.stderr.flush()
        comm.Abort(code)
    return code
