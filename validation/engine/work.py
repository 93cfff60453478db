"""The trials of a study as work: what makes them, where their results are kept, and who makes them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bcid.base.collective import Comm
from bcid.base.run_folder import sealed, unsealed, write_whole

Task = Mapping[str, Any]
Make = Callable[[Task], dict[str, Any]]


@dataclass(frozen=True)
class Work:
    """What whoever makes trials must know; it can be sent.

    Attributes:
        maker: function as "module:name"; called once in each process with `job`, it gives the function that makes a trial:
            from its task to its result, a JSON object.
        job: what all trials share, a JSON object.
        results: folder of the results.
    """

    maker: str
    job: Mapping[str, Any]
    results: Path

    def file(self, name: str) -> Path:
        """Where the result of a trial is."""
        return self.results / f"{name}.json"

    def record(
        self, name: str, task: Task, state: str, reason: str, seconds: float, result: Task | None = None
    ) -> None:
        """Write the result of a trial whole: what the maker gave, or why there is nothing."""
        about = {"name": name, "state": state, "reason": reason, "seconds": round(seconds, 4), "task": dict(task)}
        content = sealed(about | {"result": None if result is None else dict(result)})
        write_whole(self.file(name), json.dumps(content, allow_nan=False) + "\n")


def read_result(file: Path) -> dict[str, Any]:
    """What `Work.record` wrote.

    Raises:
        InputError: it is missing or damaged.
    """
    return unsealed(file, "remove it, it is made again")


@dataclass(frozen=True)
class Workers:
    """Who makes the trials.

    Attributes:
        comm: MPI communicator of more than one rank, over which they are spread; None for child processes.
        jobs: child processes at a time.
        limit: CPU seconds that a trial may take.
        tries: how often a trial whose process dies is made: what killed it may have been meant for another.
        fresh: every trial gets a process of its own.
    """

    comm: Comm | None = None
    jobs: int = 2
    limit: float = 900.0
    tries: int = 6
    fresh: bool = False
