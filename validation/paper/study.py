"""Running a study file into a run folder: predict what all trials share, make the trials, merge and tell.

RUN/shared/           what every set predicts, and the truths; one folder for all studies of one run of the paper
RUN/results/          one file for each trial
RUN/trials.parquet    all trials;  table.txt  table.csv  study.json  page.md  picture.png  what is made of them
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.collective import on_root
from bcid.base.fingerprint import file_fingerprint, fingerprint
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import Busy, RunFolder, running
from bcid.scene import Scene
from validation.engine.dispatch import dispatch, part_of
from validation.engine.work import Work, Workers, read_result
from validation.paper import cells as results
from validation.paper import precompute as precompute
from validation.paper import study_tables
from validation.paper.claims import FAILS, Claim, claims
from validation.paper.study_file import StudyFile
from validation.paper.study_page import study_page
from validation.text_table import TextTable

# Between two looks whether another part has begun the run.
_PAUSE = 0.2
_MAKES = (
    "results/",
    "logs/",
    "shared/",
    "trials.parquet",
    "table.txt",
    "table.csv",
    "study.json",
    "page.md",
    "picture.png",
)


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
    inputs = on_root(how.comm, lambda: _inputs(study, extent))
    with running(how.comm, folder, command, inputs, _MAKES, overwrite) if whole else nullcontext() as run:
        path = on_root(how.comm, lambda: folder.resolve() if whole else _joined(folder, command, inputs))
        costs = _make(study, path, shared or path / "shared", extent, how, progress)
        if whole:
            on_root(how.comm, lambda: _conclude(run, study, costs))
    return folder


def _inputs(study: StudyFile, extent: Extent) -> dict[str, Any]:
    """What the trials depend on: texts, tables and what the paper says may be edited while a study is stopped."""
    scene = Scene.read(study.scene)
    about = [trial.name for trial in study.all_trials()], [cell.to_json() for cell in study.cells()]
    inputs = {"study": fingerprint(about), "quick": extent.quick, "seed": extent.seed}
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
    precomputed = Work("validation.paper.precompute:maker", job, shared / "precomputed")
    parts = on_root(how.comm, lambda: precompute.tasks(trials, Scene.read(study.scene), extent.seed))
    if extent.part is None or extent.only_predict:
        progress.say(f"{study.name}: {len(parts)} predictions that trials share")
        dispatch(precomputed, part_of(parts, extent.part), how, progress)
    if not extent.only_predict:
        progress.say(f"{study.name}: {len(trials)} trials")
        tasks = {t.name: {"condition": t.condition.to_json(), "number": t.number} for t in trials}
        work = Work("validation.paper.identification_trial:maker", job, path / "results")
        dispatch(work, part_of(tasks, extent.part), how, progress)
    return call_costs([precomputed.file(name) for name in parts])


def _conclude(run: RunFolder | None, study: StudyFile, costs: Mapping[str, float]) -> None:
    """Merge all trials and write what is made of them."""
    assert run is not None
    told = Summary.of(study, run.path / "results", costs)
    results.write_parquet(told.rows, run.path / "trials.parquet")
    run.write_text("table.txt", study_tables.text(study, told.tables, told.rows))
    run.write_text("table.csv", study_tables.table_csv(study, told.cells))
    run.write_json("study.json", told.to_json())
    drawn = _draw(run, study, told.cells)
    run.write_text("page.md", study_page(study, told.tables, told.rows, drawn))
    failed = sum(cell.failed for cell in told.cells)
    right = sum(cell.right * cell.count for cell in told.cells) / len(told.rows)
    not_held = sum(claim.verdict == FAILS for claim in told.claims)
    run.finish(
        {"trials": len(told.rows), "failed": failed, "right": right, "claims": len(told.claims), "not_held": not_held}
    )


@dataclass(frozen=True)
class Summary:
    """What is told of a study: its trials, their cells, what the paper says beside it, and the tables of all that.

    `costs` are the CPU seconds of one call of the model by level.
    """

    study: StudyFile
    costs: Mapping[str, float]
    rows: list[results.Row]
    cells: list[results.Cell]
    claims: list[Claim]
    tables: list[TextTable]

    @classmethod
    def of(cls, study: StudyFile, folder: Path, costs: Mapping[str, float]) -> Summary:
        """From the folder of the results.

        Raises:
            InputError: a result is missing or damaged.
        """
        rows = results.read(study, folder)
        found, said = results.cells(study, rows, costs), claims(study, rows, costs)
        return cls(study, costs, rows, found, said, study_tables.tables(study, found, rows, costs, said))

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        study = {key: getattr(self.study, key) for key in ("name", "title", "section")}
        cells, said = ([each.to_json() for each in part] for part in (self.cells, self.claims))
        return study | {"costs": dict(self.costs), "cells": cells, "claims": said}


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


def _draw(run: RunFolder, study: StudyFile, found: list[results.Cell]) -> bool:
    """Whether there is a picture: it is a view of the numbers, and without matplotlib there is none."""
    try:
        from validation.plots import is_curve, success
    except ImportError:
        return False
    if not is_curve(study):
        return False
    success(run.path / "picture.png", study, found)
    return True
