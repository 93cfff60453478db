"""One case of the hidden study in a process of its own: make the measurement, diagnose it, write the result.

Called with one argument, a JSON object: `folder` of the case, `result` file, `scene` file, `seed`, `index`, `least`
size of an effect, and the functions `make` and `diagnose` as "module:name".
"""

from __future__ import annotations

import json
import sys
import time
import traceback
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from bcid.errors import BcidError
from bcid.progress import Silent
from bcid.run import Run, write_whole
from bcid.studies.children import end_with_parent


def main(job: dict[str, Any]) -> None:
    """Work on a case until its result is written; what goes wrong is a result too."""
    folder = Path(job["folder"])
    stage, seconds, cpu = "measurement", 0.0, 0.0
    diagnosis: dict[str, Any] | None = None
    reason = ""
    try:
        function(job["make"])(folder, job["seed"], job["index"], Path(job["scene"]), job["least"])
        stage, began, began_cpu = "diagnosis", time.perf_counter(), time.process_time()
        diagnosis = diagnose(function(job["diagnose"]), folder, Path(job["scene"]))
        seconds, cpu = time.perf_counter() - began, time.process_time() - began_cpu
    except Exception as error:
        traceback.print_exc()
        told = str(error) if isinstance(error, BcidError) else f"{type(error).__name__}: {error}"
        reason = f"{stage}: {told}"
    write_result(
        Path(job["result"]), job["index"], folder, "failed" if reason else "done", reason, diagnosis, seconds, cpu
    )


def function(name: str) -> Callable[..., Any]:
    """The function "module:name"."""
    module, _, attribute = name.partition(":")
    found: Callable[..., Any] = getattr(import_module(module), attribute)
    return found


def diagnose(run_explain: Callable[..., Path], folder: Path, scene: Path) -> dict[str, Any]:
    """Diagnose the measurement of a case, given only that and the scene; a run that was interrupted goes on."""
    from mpi4py import MPI

    run = folder / "diagnosis"
    if not ((run / "run.json").is_file() and Run.open(run).record["state"] == "finished"):
        run = run_explain(scene, folder / "measurement", run, None, MPI.COMM_SELF, Silent(), False)
    result: dict[str, Any] = json.loads((run / "diagnosis.json").read_text(encoding="utf-8"))
    return result


def write_result(
    file: Path,
    index: int,
    folder: Path,
    state: str,
    reason: str = "",
    diagnosis: dict[str, Any] | None = None,
    seconds: float = 0.0,
    cpu_seconds: float = 0.0,
) -> None:
    """Write the result of a case whole: its truth, its diagnosis (None where there is none), and what these took."""
    truth = folder / "truth.json"
    content = {
        "index": index,
        "state": state,
        "reason": reason,
        "truth": json.loads(truth.read_text(encoding="utf-8")) if truth.is_file() else None,
        "diagnosis": diagnosis,
        "seconds": round(seconds, 3),
        "cpu_seconds": round(cpu_seconds, 3),
    }
    write_whole(file, json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    end_with_parent()
    main(json.loads(sys.argv[1]))
