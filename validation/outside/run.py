"""Explains worlds outside the family, each in a process of its own, and keeps the answers."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from bcid.base.progress import Progress
from validation.bench.measure import peer_python
from validation.engine.dispatch import dispatch
from validation.engine.work import Work, Workers, read_result
from validation.golden.run import LIMIT, explained
from validation.outside.case import INPUTS, prepare, store
from validation.stored_input import TRUTH

PINS = "environment/outside.txt"


def maker(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that makes and explains a case, for `validation.engine.dispatch`; `job` holds folders, see `run`."""

    def case(task: Mapping[str, Any]) -> dict[str, Any]:
        folder = Path(job["cases"]) / f"{task['kind']}-{task['index']}"
        prepare(task["kind"], task["index"], folder, job["python"])
        return explained(folder, Path(job["store"]) / folder.name if job["store"] else None)

    return case


def run(
    folder: Path, kinds: Iterable[str], cases: int, jobs: int, progress: Progress, predictions: Path | None = None
) -> None:
    """Explain measurements into a folder; those that are there already are kept, so that an interrupted run goes on.

    Args:
        folder: takes inputs and answers.
        kinds: of worlds.
        cases: measurements of each kind; the first of every kind come first.
        jobs: processes at a time.
        progress: told what is done.
        predictions: folder that keeps them for other runs.
    """
    # A folder of results is made before an independent code is installed: what cannot be written is said at once.
    (folder / "results").mkdir(parents=True, exist_ok=True)
    tasks = {f"{kind}-{index}": {"kind": kind, "index": index} for index in range(cases) for kind in kinds}
    python = None
    if not all((INPUTS / f"{name}.zip").is_file() or (folder / "cases" / name / TRUTH).is_file() for name in tasks):
        python, why = peer_python(progress.say, PINS)
        if python is None:
            progress.say(f"{PINS}: {why}")
    job = {
        "cases": str(folder.resolve() / "cases"),
        "store": str(predictions.resolve()) if predictions else "",
        "python": python,
    }
    work = Work("validation.outside.run:maker", job, folder.resolve() / "results")
    dispatch(work, tasks, Workers(None, jobs, LIMIT, tries=2, fresh=True), progress)


def read(folder: Path) -> dict[str, dict[str, Any]]:
    """The answers of a run so far, by case, with `kind`, `truth` and `diagnosis` (None where there is none)."""
    return {file.stem: _read(folder, file) for file in sorted((folder / "results").glob("*.json"))}


def _read(folder: Path, file: Path) -> dict[str, Any]:
    found = read_result(file)
    truth = folder / "cases" / file.stem / TRUTH
    known = json.loads(truth.read_text(encoding="utf-8")) if truth.is_file() else None
    nothing = {"diagnosis": None, "error": found["reason"], "cpu_seconds": found["seconds"]}
    return {"kind": found["task"]["kind"], "truth": known, **nothing, **(found["result"] or {})}


def freeze(folder: Path) -> int:
    """Keep the inputs of a run in the repository; returns how many there are."""
    made = sorted((folder / "cases").glob(f"*/{TRUTH}"))
    for truth in made:
        kind, _, index = truth.parent.name.rpartition("-")
        store(kind, int(index), truth.parent)
    return len(made)
