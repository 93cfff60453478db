"""One case of the hidden study: make the measurement, then diagnose it, given only that and its scene file."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from bcid.base.errors import BcidError, MachineError
from bcid.base.progress import Silent
from bcid.base.run_folder import RunFolder
from validation.engine.time_limit import limited
from validation.synthetic.case_scene import FILE as SCENE
from validation.synthetic.drawing import CaseChoice


class CaseError(BcidError):
    """A case that could not be made or diagnosed; the text says which."""


def maker(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that makes a case, for `validation.engine.dispatch`.

    `job` holds the folder `cases`, what they are drawn from (the fields of `CaseChoice`), the functions `make` and `diagnose`
    as "module:name", and the `limit` of a diagnosis, CPU s; a task holds the `index`.
    """
    make, diagnose = function(job["make"]), function(job["diagnose"])
    choice = CaseChoice(job["seed"], job["least"], tuple(job["bodies"]), job["conditions"])

    def case(task: Mapping[str, Any]) -> dict[str, Any]:
        folder = Path(job["cases"]) / f"{task['index']:04d}"
        with _stage("measurement"):
            make(folder, task["index"], choice)
        began, began_cpu = time.perf_counter(), time.process_time()
        with _stage("diagnosis"), limited(job["limit"]):
            diagnosis = diagnosed(diagnose, folder)
        seconds, cpu = time.perf_counter() - began, time.process_time() - began_cpu
        return {"diagnosis": diagnosis, "seconds": round(seconds, 3), "cpu_seconds": round(cpu, 3)}

    return case


@contextmanager
def _stage(name: str) -> Iterator[None]:
    """Tells in which stage something went wrong."""
    try:
        yield
    except MachineError:
        raise
    except Exception as error:
        told = str(error) if isinstance(error, BcidError) else f"{type(error).__name__}: {error}"
        raise CaseError(f"{name}: {told}") from error


def function(name: str) -> Callable[..., Any]:
    """The function "module:name"."""
    module, _, attribute = name.partition(":")
    found: Callable[..., Any] = getattr(import_module(module), attribute)
    return found


def diagnosed(run_explain: Callable[..., Path], folder: Path) -> dict[str, Any]:
    """Diagnose the measurement of a case, given that and its scene file alone; a run that was interrupted goes on."""
    from mpi4py import MPI

    run = folder / "diagnosis"
    if not ((run / "run.json").is_file() and RunFolder.open(run).record["state"] == "finished"):
        run = run_explain(folder / SCENE, folder / "measurement", run, None, MPI.COMM_SELF, Silent(), False)
    result: dict[str, Any] = RunFolder.open(run).read_json("diagnosis.json")
    return result
