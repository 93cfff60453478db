"""Stand-ins for the trials of a study, as `validation.engine.dispatch` calls them: quick, and faulty on demand."""

import os
import signal
import time
from collections.abc import Callable, Mapping
from typing import Any

from bcid.base.errors import SolveError


def maker(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """A trial notes that it was begun, waits, then fails as its task says."""

    def trial(task: Mapping[str, Any]) -> dict[str, Any]:
        with open(job["calls"], "a", encoding="utf-8") as calls:
            calls.write(f"{task['index']} {os.getpid()}\n")
        time.sleep(job.get("sleep", 0.0))
        fault = task.get("fault")
        if fault == "raise":
            raise ValueError("no such thing")
        if fault == "solve":
            raise SolveError("no equilibrium")
        if fault == "abort":
            os.abort()
        if fault == "segv":
            os.kill(os.getpid(), signal.SIGSEGV)
        if fault == "exit":
            os._exit(7)
        if fault == "nan":
            return {"value": float("nan")}
        while fault == "spin":
            pass
        if fault == "hang":
            time.sleep(600.0)
        return {"value": task["index"] ** 2}

    return trial
