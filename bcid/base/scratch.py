"""The temporary folder of the machine, into which loaders, compilers and MPI write: a failure there is told by its name."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bcid.base.errors import MachineError

# Bytes that must be free: what compiling the largest forms takes.
NEEDED = 4_000_000


@contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """A folder of its own in the temporary folder, which is removed in the end.

    Raises:
        MachineError: it cannot be made.
    """
    try:
        made = tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True)
    except OSError as error:
        raise MachineError(trouble() or _told(_place(), error)) from None
    with made as name:
        yield Path(name)


def require() -> None:
    """Raise `MachineError` when the temporary folder cannot be used, or is full."""
    found = trouble()
    if found:
        raise MachineError(found)


def trouble() -> str:
    """What is wrong with the temporary folder, in words; "" if nothing is."""
    place = _place()
    try:
        with tempfile.TemporaryFile(prefix="bcid-", dir=place) as stream:
            os.posix_fallocate(stream.fileno(), 0, NEEDED)
    except OSError as error:
        return _told(place, error)
    return ""


def _place() -> str:
    """The folder that $TMPDIR names, or the machine's: Python would pass over a bad $TMPDIR, compilers and MPI would not."""
    try:
        return os.environ.get("TMPDIR") or tempfile.gettempdir()
    except OSError:
        return "/tmp"


def _told(place: str, error: OSError) -> str:
    reason = error.strerror or str(error)
    return (
        f"the temporary folder {place} cannot be used: {reason}; free at least {NEEDED / 1e6:g} MB there, "
        "or set TMPDIR to a folder that can be written"
    )
