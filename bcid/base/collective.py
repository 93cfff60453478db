"""Doing something on one rank for all, and raising on all ranks or none."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np

from bcid.base.errors import BcidError

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm

# An MPI communicator of mpi4py, which is loaded only by what needs it.
Comm: TypeAlias = "Intracomm"

T = TypeVar("T")
# Set by the launchers of Open MPI, MPICH and Slurm.
_RANKS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID")
_SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS", "PMIX_SIZE")


def on_root(comm: Comm | None, work: Callable[[], T]) -> T:
    """Run `work` on rank 0 and give its result to every rank; collective on `comm`.

    A `BcidError` raised by `work` is raised on every rank. `comm` may be None: then `work` is just called.
    """
    if comm is None or comm.size == 1:
        return work()
    result, error = None, None
    if comm.rank == 0:
        try:
            result = work()
        except BcidError as caught:
            error = caught
    result, error = comm.bcast((result, error), root=0)
    if error is not None:
        raise error
    return result


def in_turns(comm: Comm, first: bool, work: Callable[[], T]) -> T:
    """Run `work` on the ranks that are `first`, then on the others, and raise on all ranks or none; collective on `comm`.

    So one rank compiles what the others then find in the cache: compiling at once would race for it.
    """
    results: list[T] = []
    for turn in (True, False):
        error = None
        if bool(first) == turn:
            try:
                results.append(work())
            except Exception as caught:
                error = caught
        agree(comm, error)
    return results[0]


def agree(comm: Comm, error: Exception | None) -> None:
    """Raise the first error of any rank on every rank; collective on `comm`."""
    found = [e for e in comm.allgather(error) if e is not None]
    if found:
        raise found[0]


def launched() -> bool:
    """Whether this process is one of several that an MPI launcher has started."""
    return any(os.environ.get(name, "").isdigit() and int(os.environ[name]) > 1 for name in _SIZES)


def first() -> bool:
    """Whether this process is the first that an MPI launcher has started, or the only one; known before MPI is begun."""
    return all(os.environ.get(name, "0") == "0" for name in _RANKS)


def overlaid(arrays: Sequence[Any]) -> Any:
    """Arrays of one shape that ranks know in parts, with NaN elsewhere, as one; local."""
    result = arrays[0].copy()
    for other in arrays[1:]:
        fill = np.isnan(result)
        result[fill] = other[fill]
    return result
