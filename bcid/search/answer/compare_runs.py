"""`bcid compare`, `diagnose`, `fit` and `explain` as commands: read, check, work, and write everything into a run folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError
from bcid.base.options import ExplainOptions, check_level
from bcid.base.progress import Progress
from bcid.base.run_folder import RunFolder, running
from bcid.predict.predictor import Predictor
from bcid.predict.store import CHECKPOINT, PredictionStore
from bcid.results.run_documents import write_documents
from bcid.search.answer.diagnosis import Diagnosis, check_terms, compared, diagnosed, explained, on_predictor, refitted
from bcid.search.answer.output import collect, documents
from bcid.search.answer.source import Source, find_effect, from_files, from_run
from bcid.search.answer.written_term import parsed_term

MAKES = (
    *(
        "diagnosis.json",
        "model.json",
        "identification.json",
        "residuals.nc",
        "body.nc",
        "discrepancy.json",
        "summary.txt",
    ),
    *("picture.png", "models.png", "discrepancy.png", "paraview/", "report.html", f"{CHECKPOINT}/"),
)
# Where `explain` finds that no known effect explains the measurement, a term that does is looked for in a folder of its own.
_EXPLAIN_MAKES = (*MAKES, "propose/")


def run_compare(
    folder: Path,
    output: Path,
    comm: Comm,
    progress: Progress | None = None,
    overwrite: bool = False,
    level: int | None = None,
    files: Sequence[Path] = (),
    store: Path | None = None,
) -> Path:
    """Is the model of a run adequate, and where does it fail? Collective; returns the folder written."""
    source = from_run(folder, files, comm)
    return _written("compare", source, output, {"level": level}, comm, overwrite, level, compared, progress, store)


def run_diagnose(
    folder: Path,
    output: Path,
    comm: Comm,
    progress: Progress | None = None,
    overwrite: bool = False,
    level: int | None = None,
    files: Sequence[Path] = (),
    only: Sequence[str] | None = None,
    store: Path | None = None,
) -> Path:
    """Which effect is missing in the model of a run? Collective; returns the folder written."""
    source = from_run(folder, files, comm)
    for name in only or ():
        find_effect(name, source.own)
    options = {"level": level, "only": list(only) if only else None}
    work = partial(diagnosed, only=only)
    return _written("diagnose", source, output, options, comm, overwrite, level, work, progress, store)


def run_fit(
    folder: Path,
    output: Path,
    comm: Comm,
    progress: Progress | None = None,
    overwrite: bool = False,
    level: int | None = None,
    files: Sequence[Path] = (),
    add: Sequence[str] = (),
    free: Sequence[str] = (),
    fixed: Sequence[str] = (),
    store: Path | None = None,
) -> Path:
    """Add effects to the model of a run, refit it, and compare the errors; collective; returns the folder written.

    Args:
        add: effects as a user writes them, see `bcid.search.answer.written_term.parsed_term`.
        free: further numbers to fit, such as "young".
        fixed: numbers to keep, such as "gravity.weight".
    """
    source = from_run(folder, files, comm)
    terms = [parsed_term(text, source) for text in add]
    check_terms(source, terms, free, fixed)
    options = {"level": level, "add": list(add), "free": list(free), "fixed": list(fixed)}
    work = partial(refitted, terms=terms, free=free, fixed=fixed)
    return _written("fit", source, output, options, comm, overwrite, level, work, progress, store)


def run_explain(
    scene_file: Path,
    measurement_file: Path,
    folder: Path,
    options: ExplainOptions | None,
    comm: Comm,
    progress: Progress | None = None,
    overwrite: bool = False,
    files: Sequence[Path] = (),
    store: Path | None = None,
) -> Path:
    """Anchors and missing effects, unattended, until adequate or unknown; collective; returns the folder written.

    `store` is a folder of predictions that runs share, here and in the other commands; by default they last as long as the run.
    """
    chosen = options or ExplainOptions()
    source = from_files(scene_file, measurement_file, files, comm)
    for name in chosen.only or ():
        find_effect(name, source.own)
    if progress is not None:
        for text in source.measurement.remarks:
            progress.say(f"look at this first: {text}")
    work = partial(explained, options=chosen)
    return _written("explain", source, folder, asdict(chosen), comm, overwrite, chosen.level, work, progress, store)


def _written(
    command: str,
    source: Source,
    folder: Path,
    options: Any,
    comm: Comm,
    overwrite: bool,
    level: int | None,
    work: Callable[[Predictor, Source], Diagnosis],
    progress: Progress | None,
    store: Path | None,
) -> Path:
    check_level(level, source.scene, "--level")
    if on_root(comm, lambda: store is not None and store.exists() and not store.is_dir()):
        raise InputError(f"--store {store}: is a file; name a folder")
    makes = _EXPLAIN_MAKES if command == "explain" else MAKES
    inputs = source.inputs(options)
    with running(comm, folder, command, inputs, makes, overwrite) as run:
        kept = PredictionStore.of_run(folder, comm, {"effects": inputs["effects"]}, progress, store)

        def use(predictor: Predictor, here: Source, done: Diagnosis) -> None:
            content = collect(predictor, done)
            on_root(comm, lambda: _write(run, here, predictor, done, content))

        on_predictor(source, comm, level, progress, work, use, kept)
        kept.clear()
    return folder


def _write(
    run: RunFolder | None, source: Source, predictor: Predictor, done: Diagnosis, content: dict[str, Any]
) -> None:
    """Write everything into the run folder, which only rank 0 has, and finish the run."""
    assert run is not None
    finish(run, source, predictor, documents(source, done, content), content)


def finish(
    run: RunFolder, source: Source, predictor: Predictor, found: dict[str, Any], content: dict[str, Any]
) -> None:
    """Write the documents of a diagnosis into its run folder, and note how it ended."""
    write_documents(run, found)
    run.record |= {
        "names": {"scene": str(source.scene_file), "measurement": str(source.measurement_file)},
        "ranks": predictor.comm.size,
        "trajectories": {k: round(v, 3) for k, v in predictor.trajectories.items()},
        "mesh": content["mesh"].fingerprint(),
    }
    if predictor.store is not None:
        steps = predictor.store
        run.record["steps"] = {"computed": steps.computed, "recalled": steps.recalled}
    told = ("adequate", "verdict", "anchored", "rms", "noise_rms")
    result = found["diagnosis.json"].to_json()
    run.finish({key: result[key] for key in told})
