"""Running a study file into a run folder: predict what all trials share, make the trials, merge and tell.

RUN/shared/           what every set predicts, and the truths; one folder for all studies of one run of the paper
RUN/results/          one file for each trial
RUN/trials.parquet    all trials;  table.txt  table.csv  study.json  picture.png  what is made of them
"""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.collective import on_root
from bcid.base.fingerprint import file_fingerprint
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import Busy, RunFolder, running
from bcid.scene import Scene
from bcid.studies.engine.dispatch import dispatch, part_of
from bcid.studies.engine.work import Work, Workers, read_result
from bcid.studies.paper import cells as results
from bcid.studies.paper import precompute as precompute
from bcid.studies.paper.condition import written
from bcid.studies.paper.study_file import StudyFile

# Between two looks whether another part has begun the run.
_PAUSE = 0.2
_MAKES = ("results/", "logs/", "shared/", "trials.parquet", "table.txt", "table.csv", "study.json", "picture.png")


@dataclass(frozen=True)
class Extent:
    """How much of a study one command does.

    Attributes:
        quick: the reduced study.
        part: (i, n): only every n-th trial, from the i-th; the tables are made by a command without it.
        only_predict: only what all trials share.
        seed: of what is random in the trials.
    """

    quick: bool = False
    part: tuple[int, int] | None = None
    only_predict: bool = False
    seed: int = 0


def run_study(
    file: Path,
    folder: Path,
    extent: Extent,
    how: Workers,
    progress: Progress | None = None,
    overwrite: bool = False,
    shared: Path | None = None,
) -> Path:
    """Run a study file into a run folder; collective on `how.comm`. One that was interrupted goes on.

    Args:
        shared: folder of what trials share, if other than the run's own.

    Raises:
        InputError: the file, or a folder that cannot be used (see `RunFolder.start`).
    """
    progress = progress or Silent()
    study = on_root(how.comm, lambda: StudyFile.read(file, extent.quick))
    whole = extent.part is None and not extent.only_predict
    command = f"study {study.name}"
    inputs = on_root(how.comm, lambda: _inputs(file, study, extent))
    with running(how.comm, folder, command, inputs, _MAKES, overwrite) if whole else nullcontext() as run:
        path = on_root(how.comm, lambda: folder.resolve() if whole else _joined(folder, command, inputs))
        costs = _make(study, path, shared or path / "shared", extent, how, progress)
        if whole:
            on_root(how.comm, lambda: _conclude(run, study, costs))
    return folder


def _inputs(file: Path, study: StudyFile, extent: Extent) -> dict[str, Any]:
    """What the results depend on."""
    scene = Scene.read(study.scene)
    inputs = {"study": file_fingerprint(file), "quick": extent.quick, "seed": extent.seed}
    return inputs | {"scene": file_fingerprint(study.scene), "geometry": file_fingerprint(scene.geometry)}


def _joined(folder: Path, command: str, inputs: dict[str, Any]) -> Path:
    """Begin a run, or take part in one: several processes write their own files into it at once."""
    while True:
        try:
            run = RunFolder.start(folder, command, inputs)
        except Busy:
            time.sleep(_PAUSE)
        else:
            run.release()
            return run.path.resolve()


def _make(
    study: StudyFile, path: Path, shared: Path, extent: Extent, how: Workers, progress: Progress
) -> dict[str, float]:
    """Predict, then make the trials; the CPU seconds of one call of the model by level."""
    trials = study.all_trials()
    job = {"scene": str(study.scene.resolve()), "predictions": str(shared / "predictions"), "seed": extent.seed}
    precomputed = Work("bcid.studies.paper.precompute:maker", job, shared / "precomputed")
    parts = on_root(how.comm, lambda: precompute.tasks(trials, Scene.read(study.scene)))
    if extent.part is None or extent.only_predict:
        progress.say(f"{study.name}: {len(parts)} predictions that trials share")
        dispatch(precomputed, part_of(parts, extent.part), how, progress)
    if not extent.only_predict:
        progress.say(f"{study.name}: {len(trials)} trials")
        tasks = {t.name: {"condition": t.condition.to_json(), "number": t.number} for t in trials}
        work = Work("bcid.studies.paper.identification_trial:maker", job, path / "results")
        dispatch(work, part_of(tasks, extent.part), how, progress)
    return call_costs([precomputed.file(name) for name in parts])


def _conclude(run: RunFolder | None, study: StudyFile, costs: Mapping[str, float]) -> None:
    """Merge all trials and write what is made of them."""
    assert run is not None
    rows = results.read(study, run.path / "results")
    found = results.cells(study, rows)
    results.write_parquet(rows, run.path / "trials.parquet")
    run.write_text("table.txt", results.text(study, rows, costs))
    run.write_text("table.csv", table_csv(study, found))
    told = {"name": study.name, "title": study.title, "section": study.section, "costs": dict(costs)}
    run.write_json("study.json", told | {"cells": [cell.to_json() for cell in found]})
    _draw(run, study, found)
    failed = sum(cell.failed for cell in found)
    right = sum(cell.right * cell.count for cell in found) / len(rows)
    run.finish({"trials": len(rows), "failed": failed, "right": right})


def call_costs(files: Iterable[Path]) -> dict[str, float]:
    """CPU seconds of one call of the model by level: the median of what was precomputed."""
    spent: dict[str, list[float]] = {}
    for file in files:
        if not file.is_file():
            continue
        result = read_result(file)["result"]
        if result and result["level"] is not None:
            spent.setdefault(str(result["level"]), []).append(result["seconds"])
    return {level: float(np.median(seconds)) for level, seconds in sorted(spent.items())}


def table_csv(study: StudyFile, found: list[results.Cell]) -> str:
    """The cells as CSV, lengths in mm."""
    levels = sorted({level for cell in found for level in cell.calls})
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        [
            *study.vary,
            "trials",
            "failed",
            "right",
            "low",
            "high",
            "best_right",
            "rms_mm",
            *(f"calls_{x}" for x in levels),
        ]
    )
    for cell in found:
        values: Mapping[str, Any] = cell.values
        numbers = [cell.right, *cell.interval, cell.best_right, None if cell.rms is None else cell.rms * 1e3]
        numbers += [cell.calls.get(level) for level in levels]
        told = ["" if n is None else f"{n:.6g}" for n in numbers]
        writer.writerow([*(written(n, v) for n, v in values.items()), cell.count, cell.failed, *told])
    return stream.getvalue()


def _draw(run: RunFolder, study: StudyFile, found: list[results.Cell]) -> None:
    """The picture is a view of the numbers: without matplotlib there is none."""
    try:
        from bcid.studies.plots import success
    except ImportError:
        return
    success(run.path / "picture.png", study, found)
