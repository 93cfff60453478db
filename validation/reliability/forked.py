"""Readers of foreign files as forks of a process that has their libraries loaded: many cases in the time that one start takes.

A fork is confined as a child is, and reads the same copy with the same limits; it only does not start an interpreter.
"""

from __future__ import annotations

import os
import resource
import runpy
import signal
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import NoReturn

from bcid.base import confined

_LIBRARIES = ("scipy.io", "h5py", "meshio", "gmsh", "nibabel", "cv2", "rosbags.highlevel", "ezc3d")


def install() -> None:
    """Make `read_in_child` of this process fork."""
    for name in _LIBRARIES:
        with suppress(ImportError):
            import_module(name)
    confined._run = _run


def _run(command: Sequence[str], folder: Path, seconds: float) -> tuple[int, list[str]]:
    """As that of `bcid.base.confined`, which this stands in for."""
    said = [folder / name for name in ("said", "faults")]
    # What is imported once need not be imported in every fork.
    import_module(command[3])
    child = os.fork()
    if child == 0:
        _be_child(command, folder, said, seconds)
    try:
        if not confined._ends(child, seconds):
            raise TimeoutError(f"reading took more than {seconds:.0f} s")
    finally:
        with suppress(OSError):
            os.killpg(child, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return code, b"\n".join(map(confined._end, said)).decode("utf-8", "replace").strip().splitlines()


def _be_child(command: Sequence[str], folder: Path, said: Sequence[Path], seconds: float) -> NoReturn:
    code = 1
    try:
        os.setsid()
        # PETSc, where it is loaded, would catch what a child dies of.
        for number in (signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT, signal.SIGPIPE):
            signal.signal(number, signal.SIG_DFL)
        for place, file in enumerate((Path(os.devnull), *said)):
            os.dup2(os.open(file, os.O_RDWR | os.O_CREAT, 0o600), place)
        environment = confined.environment_of_child(folder)
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(folder)
        limit = int(seconds) + 2
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        sys.argv = list(command[3:])
        runpy.run_module(command[3], run_name="__main__")
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        os._exit(code)
