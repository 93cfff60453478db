"""Runs `bcid explain` on golden cases, each in a process of its own, and keeps what it answers."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from bcid.base.progress import Progress
from bcid.base.run_folder import RunFolder, write_whole
from validation.engine.dispatch import dispatch
from validation.engine.work import Work, Workers, read_result
from validation.golden.cases import CASES, MEASUREMENT, SCENE, prepare, store

ANSWERS = Path(__file__).resolve().parent / "answers"
# CPU seconds of a case: its input may have to be made by elements of high order, then it is explained.
LIMIT = 1800.0


def maker(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that explains a case, for `validation.engine.dispatch`; `job` holds folders and numbers, see `run`."""
    if job["numbers"]:
        _change_numbers(job["numbers"])

    def case(task: Mapping[str, Any]) -> dict[str, Any]:
        folder = Path(job["cases"]) / task["name"]
        prepare(task["name"], folder)
        return explained(folder, Path(job["store"]) / task["name"] if job["store"] else None)

    return case


def _change_numbers(changes: Mapping[str, Any]) -> None:
    """For the whole process, which is one of a single case: all modules share the objects."""
    from bcid.inference import priors, thresholds
    from bcid.search import settings

    for name, value in changes.items():
        (one,) = (o for o in (priors.PRIORS, thresholds.THRESHOLDS, settings.SETTINGS) if hasattr(o, name))
        object.__setattr__(one, name, tuple(value) if isinstance(value, list) else value)


def explained(folder: Path, store: Path | None = None) -> dict[str, Any]:
    """What `bcid explain` answers for a case, given its scene and measurement alone, and what that costs."""
    from mpi4py import MPI

    from bcid.base.progress import Silent
    from validation.explained import run_explain

    began, began_cpu = time.perf_counter(), time.process_time()
    shutil.rmtree(folder / "run", ignore_errors=True)
    try:
        # Code of which answers are frozen may keep no predictions.
        kept: dict[str, Any] = {} if store is None else {"store": store}
        run_explain(folder / SCENE, folder / MEASUREMENT, folder / "run", None, MPI.COMM_SELF, Silent(), False, **kept)
        run = RunFolder.open(folder / "run")
        answer = {"diagnosis": run.read_json("diagnosis.json"), "trajectories": run.record["trajectories"]}
    except Exception as error:
        # How a run fails is frozen as well.
        answer = {"diagnosis": None, "trajectories": None, "error": f"{type(error).__name__}: {error}"}
    cost = {"seconds": time.perf_counter() - began, "cpu_seconds": time.process_time() - began_cpu}
    return answer | {name: round(value, 1) for name, value in cost.items()}


def run(
    folder: Path,
    names: Iterable[str],
    jobs: int,
    progress: Progress,
    store: Path | None = None,
    numbers: Mapping[str, Any] | None = None,
) -> None:
    """Explain cases into a folder; what is there already is kept, so that a run that was interrupted goes on.

    Predictions are kept in `store`, so that a change of what weighs them is tried without computing them again. `numbers`
    are fields of `Priors`, `Thresholds` or `SearchSettings` that differ from those in the repository.
    """
    job = {
        "cases": str(folder.resolve() / "cases"),
        "store": str(store.resolve()) if store else "",
        "numbers": numbers or {},
    }
    work = Work("validation.golden.run:maker", job, folder.resolve() / "results")
    how = Workers(None, jobs, LIMIT, tries=2, fresh=True)
    dispatch(work, {name: {"name": name} for name in names}, how, progress)


def read(folder: Path) -> dict[str, dict[str, Any]]:
    """What a run has answered so far, by case."""
    return {name: _read(folder, name) for name in CASES if (folder / "results" / f"{name}.json").is_file()}


def _read(folder: Path, name: str) -> dict[str, Any]:
    found = read_result(folder / "results" / f"{name}.json")
    truth = folder / "cases" / name / "truth.json"
    known = json.loads(truth.read_text(encoding="utf-8")) if truth.is_file() else None
    nothing = {"diagnosis": None, "trajectories": None, "error": found["reason"], "seconds": found["seconds"]}
    return {"name": name, "state": found["state"], "truth": known, **nothing, **(found["result"] or {})}


def frozen() -> dict[str, dict[str, Any]]:
    """The answers in the repository, by case."""
    return {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in sorted(ANSWERS.glob("*.json"))}


def freeze(folder: Path) -> int:
    """Make the answers of a run, and its inputs, those in the repository; returns how many there are."""
    found = read(folder)
    for name, answer in found.items():
        store(name, folder / "cases" / name)
        write_whole(ANSWERS / f"{name}.json", json.dumps(answer, sort_keys=True, separators=(",", ":")) + "\n")
    return len(found)
