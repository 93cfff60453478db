"""Forms and expressions, compiled into folders that stay small, and that a killed compilation does not spoil.

DOLFINx keeps all that it ever compiled in one folder, and FFCx lists that folder whenever it loads from it: 10 ms for each form
where it has gathered 16,000 files. In one of 256 folders below it, by the form's signature, the list is short.

FFCx begins with an empty `.c` file, and whoever finds one waits for the `.c.cached` beside it. A compilation that was killed
never writes that. A lock of the kernel, which is free when its process is gone, tells a killed compilation from one that works.
"""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from dolfinx import fem, jit
from numpy.typing import NDArray
from ufl.domain import extract_unique_domain

from bcid.base.collective import Comm


def form(integrals: Any) -> Any:
    """The compiled form of integrals in UFL; collective on its mesh."""
    folder = _kept_in(integrals.signature()[:2])
    with _alone_in(folder, integrals.ufl_domains()[0].ufl_cargo().comm):
        return fem.form(integrals, jit_options={"cache_dir": str(folder)})


def expression(value: Any, points: NDArray[Any]) -> Any:
    """A value in UFL that can be evaluated at points of the reference cell, shape (n, 3); collective on its mesh."""
    folder = _kept_in("expressions")
    with _alone_in(folder, extract_unique_domain(value).ufl_cargo().comm):
        return fem.Expression(value, points, jit_options={"cache_dir": str(folder)})


def _kept_in(folder: str) -> Path:
    return Path(jit.get_options()["cache_dir"]) / folder


@contextmanager
def _alone_in(folder: Path, comm: Comm) -> Iterator[None]:
    """Keep other processes from compiling into a folder, without what a killed one left there; collective on `comm`."""
    # A rank that holds the lock waits for the others, which must not wait for the lock elsewhere.
    comm.Barrier()
    if comm.rank > 0:
        yield
        return
    with _locked(folder):
        yield


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder. One that cannot be written can only be read, and needs none."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / ".lock").open("ab")
    except OSError:
        yield
        return
    with lock:
        # Some network file systems have no locks: there it is as without.
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX)
            for begun in folder.glob("*.c"):
                if not begun.with_suffix(".c.cached").exists():
                    begun.unlink()
        yield
