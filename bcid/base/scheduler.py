"""Who evaluates what: every worker takes the next task when it is free, so that none waits while there is work."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Protocol, TypeVar

import numpy as np

from bcid.base.collective import Comm, agree
from bcid.base.errors import BcidError

T = TypeVar("T")


class Counter(Protocol):
    """Hands out 0, 1, 2, ...: every number once, to whoever asks next."""

    def take(self) -> int:
        """The next number."""


class Alone:
    """The counter of a single worker."""

    def __init__(self) -> None:
        self.value = -1

    def take(self) -> int:
        """The next number."""
        self.value += 1
        return self.value

    def close(self) -> None:
        """Nothing to free."""


class Shared:
    """A counter of all ranks: a number in the memory of rank 0 that each advances by itself (MPI-3 one-sided).

    No rank serves it. Building and closing it are collective.
    """

    def __init__(self, comm: Comm) -> None:
        from mpi4py import MPI

        self._add = MPI.SUM
        self._window = MPI.Win.Allocate(8 if comm.rank == 0 else 0, 8, comm=comm)
        if comm.rank == 0:
            memory: Any = self._window.tomemory()
            np.frombuffer(memory, dtype=np.int64)[:] = 0
        comm.Barrier()
        self._window.Lock_all()

    def take(self) -> int:
        """The next number."""
        value = np.zeros(1, dtype=np.int64)
        self._window.Fetch_and_op(np.ones(1, dtype=np.int64), value, 0, 0, self._add)
        self._window.Flush(0)
        return int(value[0])

    def close(self) -> None:
        """Free the counter."""
        self._window.Unlock_all()
        self._window.Free()


def counter(comm: Comm) -> Alone | Shared:
    """A counter for the ranks of `comm`; collective."""
    return Alone() if comm.size == 1 else Shared(comm)


def share(tasks: Sequence[Any], tickets: Counter) -> Iterator[Any]:
    """The tasks that fall to this worker, in order; tasks that take long should come first."""
    while (i := tickets.take()) < len(tasks):
        yield tasks[i]


@dataclass(frozen=True)
class Team:
    """Ranks that work on a task together; the first of each team takes its tasks.

    Attributes:
        comm: the ranks of this rank's team.
        leaders: the first ranks of all teams; None on the others.
    """

    comm: Comm
    leaders: Comm | None

    @classmethod
    def of(cls, comm: Comm, size: int) -> Team:
        """Teams of so many neighbouring ranks, which must divide their number; collective."""
        together: Any = comm.Split(comm.rank // size, comm.rank)
        first: Any = comm.Split(0 if together.rank == 0 else 1, comm.rank)
        if together.rank == 0:
            return cls(together, first)
        first.Free()
        return cls(together, None)

    def free(self) -> None:
        """Free the communicators; collective."""
        self.comm.Free()
        if self.leaders is not None:
            self.leaders.Free()


def spread(comm: Comm, count: int, work: Callable[[int], T], team: Team | None = None) -> list[T]:
    """What work makes of each of so many things, each on some rank or team, in order and on every rank; collective.

    They are handed out in order: when one is begun those before it are done, or nearly.

    Args:
        comm: the ranks.
        count: of things.
        work: makes something of one of them; with a team it is collective there.
        team: of this rank; by default each rank works by itself.

    Raises:
        BcidError: what the work on one of them raises, on all ranks.
    """
    mine: list[tuple[int, T]] = []
    error = None
    leaders = comm if team is None else team.leaders
    tickets = None if leaders is None else counter(leaders)
    turns = iter(()) if tickets is None else share(range(count), tickets)
    while (number := _next(turns, team)) is not None:
        try:
            mine.append((number, work(number)))
        except BcidError as caught:
            error = caught
            break
    if tickets is not None:
        tickets.close()
    agree(comm, error)
    gathered = comm.allgather(mine if leaders is not None else [])
    return [found for _, found in sorted((one for part in gathered for one in part), key=itemgetter(0))]


def _next(turns: Iterator[int], team: Team | None) -> int | None:
    """The next number of this rank, or of its team; None where there is none."""
    number = next(turns, None)
    return number if team is None or team.comm.size == 1 else team.comm.bcast(number)


def replay(durations: Sequence[float], workers: int, latency: float = 0.0) -> tuple[float, float]:
    """Seconds that `workers` need for one batch of tasks, and those of work, when `share` deals them out.

    Each worker is a run of `share` on a clock of its own; the one whose clock is behind asks next. `latency` is what
    taking a number costs.
    """
    tickets = Alone()
    clocks = [(0.0, worker) for worker in range(workers)]
    runs = [share(durations, tickets) for _ in range(workers)]
    end = 0.0
    while clocks:
        now, worker = heapq.heappop(clocks)
        duration = next(runs[worker], None)
        end = max(end, now + latency)
        if duration is not None:
            heapq.heappush(clocks, (now + latency + duration, worker))
    return end, float(sum(durations))
