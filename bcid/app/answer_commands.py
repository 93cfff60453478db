"""What the commands do that answer from a measurement, once their arguments are parsed."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from bcid.app.console import beside_the_result, draw, finish, progress_of, tell
from bcid.app.flags import given, made
from bcid.app.shared_flags import all_names
from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError
from bcid.base.options import ExplainOptions, ExploreOptions, IdentifyOptions, ProposeOptions, StageOptions
from bcid.base.progress import Progress, clear
from bcid.base.run_folder import RunFolder
from bcid.base.shipped import shipped
from bcid.results.diagnosis_record import DiagnosisRecord
from bcid.results.run_documents import read_record

if TYPE_CHECKING:
    from bcid.search.answer.job import Job
    from bcid.search.answer.source import Source

DEMO_SCENE = "examples/scenes/slab_explain.toml"
DEMO_MEASUREMENT = "examples/measurements/slab-34-heavy"


def demo(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid demo`."""
    scene, measurement = shipped(DEMO_SCENE), shipped(DEMO_MEASUREMENT)
    progress = progress_of(arguments, comm.rank)
    progress.say("a soft slab was pulled five times; which patches hold it, and what does the plain model lack?")
    progress.say("searching the anchors with the plain model first")
    folder = _explained(scene, measurement, arguments, comm, progress)
    if comm.rank > 0:
        return
    if not arguments.no_picture:
        draw(folder, progress)
    from bcid.report.text import falling

    clear()
    run = RunFolder.open(folder)
    found = read_record(run, DiagnosisRecord).converted("mm")
    tell("\n" + run.read_text("summary.txt").split("\n\n")[0])
    tell(f"{falling(found)}\n\nrun folder: {folder} (summary.txt tells more)")
    if not arguments.no_picture:
        _demo_report(folder)


def _demo_report(folder: Path) -> None:
    """The page that the demo ends with."""
    with beside_the_result("report"):
        from bcid.report.page import write_report

        made = write_report([folder], folder / "report.html")
        tell(f"report: {made.path} (open it in a browser)")


def identify(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid identify`."""
    from bcid.search.answer.identification_job import IdentificationJob

    options = made(IdentifyOptions, arguments, {"stages": _stages(arguments)})
    progress = progress_of(arguments, comm.rank)
    job = IdentificationJob.of_files(arguments.scene, arguments.measurement, options, comm, arguments.refine)
    _run(job, arguments.output, arguments, comm, progress)


def _stages(arguments: argparse.Namespace) -> StageOptions | None:
    """Options of the search in stages; None where it is not asked for."""
    found = given(StageOptions, arguments)
    if found and not arguments.stages:
        name = next(iter(found)).replace("_", "-")
        raise InputError(f"--{name}: is of the search in stages; add --stages")
    return StageOptions(**found) if arguments.stages else None


def compare(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid compare`."""
    from bcid.search.answer.comparison_job import compare_job

    progress = progress_of(arguments, comm.rank)
    job = compare_job(_source(arguments, comm), _level(arguments))
    _run(job, _beside(arguments, "compare"), arguments, comm, progress)


def diagnose(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid diagnose`."""
    from bcid.search.answer.comparison_job import diagnose_job

    progress = progress_of(arguments, comm.rank)
    only = given(ExplainOptions, arguments, ("only",)).get("only")
    job = diagnose_job(_source(arguments, comm), _level(arguments), only)
    _run(job, _beside(arguments, "diagnose"), arguments, comm, progress)


def fit(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid fit`."""
    from bcid.search.answer.comparison_job import fit_job

    if not (arguments.add or arguments.free):
        raise InputError("fit: nothing to do; name an effect with --add (as --add gravity) or a number with --free")
    progress = progress_of(arguments, comm.rank)
    free, fixed = (all_names(getattr(arguments, name)) for name in ("free", "fixed"))
    job = fit_job(_source(arguments, comm), _level(arguments), arguments.add, free, fixed)
    _run(job, arguments.output, arguments, comm, progress)


def _source(arguments: argparse.Namespace, comm: Comm) -> Source:
    """What an earlier run ended with."""
    from bcid.search.answer.source import from_run

    return from_run(arguments.run_folder, arguments.effects, comm)


def _level(arguments: argparse.Namespace) -> int | None:
    level: int | None = given(ExplainOptions, arguments, ("level",)).get("level")
    return level


def _run(job: Job, folder: Path, arguments: argparse.Namespace, comm: Comm, progress: Progress) -> None:
    """Compute a job into a folder, and show what came out."""
    made = job.run(folder, comm, progress, arguments.overwrite, getattr(arguments, "store", None))
    finish(made, arguments, comm, progress)


def explain(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid explain`."""
    made(ExplainOptions, arguments).check()
    progress, folder = progress_of(arguments, comm.rank), arguments.output
    if on_root(comm, lambda: _lacks_a_proposal(arguments)):
        progress.say(f"{folder} holds the explanation already: going on from there")
    else:
        folder = _explained(arguments.scene, arguments.measurement, arguments, comm, progress)
        finish(folder, arguments, comm, progress)
    if arguments.no_propose or _verdict(folder, comm) != "unknown":
        return
    progress.say("no known effect explains it: looking for a term that does (--no-propose leaves that out)")
    _proposed(folder, None, folder / "propose", arguments, comm, progress)


def _lacks_a_proposal(arguments: argparse.Namespace) -> bool:
    """Whether the same command has explained the measurement before, and was ended while it looked for a term beyond."""
    folder = arguments.output
    if arguments.overwrite or arguments.no_propose or not (folder / "run.json").is_file():
        return False
    run = RunFolder.open(folder)
    names = {"scene": str(arguments.scene), "measurement": str(arguments.measurement)}
    options = json.loads(json.dumps(asdict(made(ExplainOptions, arguments))))
    known = run.record["command"], run.record["state"], run.record.get("names"), run.record["inputs"].get("options")
    if known != ("explain", "finished", names, options):
        return False
    begun = folder / "propose"
    proposed = (begun / "run.json").is_file() and RunFolder.open(begun).record["state"] == "finished"
    return not proposed and read_record(run, DiagnosisRecord).verdict == "unknown"


def _verdict(folder: Path, comm: Comm) -> str:
    """Of a run, the same on every rank."""
    return on_root(comm, lambda: read_record(RunFolder.open(folder), DiagnosisRecord).verdict)


def propose(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid propose`."""
    folder = arguments.folder or arguments.run_folder.with_name(f"{arguments.run_folder.resolve().name}-propose")
    progress = progress_of(arguments, comm.rank)
    _proposed(arguments.run_folder, arguments.output, folder, arguments, comm, progress)


def _proposed(
    run: Path, output: Path | None, folder: Path, arguments: argparse.Namespace, comm: Comm, progress: Progress
) -> None:
    """Search the grammar beside the model of a run, and tell what came out."""
    from bcid.grammar.proposal_job import ProposalJob

    names = () if arguments.command == "propose" else ("level",)
    options = ProposeOptions(**given(ProposeOptions, arguments, names))
    job = ProposalJob.of_run(run, output, comm, options, arguments.overwrite, arguments.effects)
    job.run(folder, comm, progress, arguments.overwrite)
    finish(folder, arguments, comm, progress)
    for file in job.files(folder) if comm.rank == 0 else ():
        tell(f"effect: {file} (use it with --effects {file})")


def _explained(scene: Path, measurement: Path, arguments: argparse.Namespace, comm: Comm, progress: Progress) -> Path:
    """Run the whole loop; returns the run folder."""
    from bcid.search.answer.comparison_job import explain_job
    from bcid.search.answer.source import from_files

    source = from_files(scene, measurement, getattr(arguments, "effects", []), comm)
    job = explain_job(source, made(ExplainOptions, arguments))
    for text in source.measurement.remarks:
        progress.say(f"look at this first: {text}")
    return job.run(arguments.output, comm, progress, arguments.overwrite, getattr(arguments, "store", None))


def _beside(arguments: argparse.Namespace, command: str) -> Path:
    run: Path = arguments.run_folder
    output: Path = arguments.output or run.with_name(f"{run.resolve().name}-{command}")
    return output


def explore(arguments: argparse.Namespace, comm: Comm) -> None:
    """`bcid explore`."""
    from bcid.exploration.explore_run import run_exploration

    if not arguments.wait > 0:
        raise InputError(f"--wait {arguments.wait:g}: must be a positive number of seconds")
    options = made(ExploreOptions, arguments)
    progress = progress_of(arguments, comm.rank)
    folder = run_exploration(
        arguments.scene,
        arguments.robot,
        arguments.output,
        options,
        comm,
        progress,
        arguments.overwrite,
        arguments.store,
        arguments.wait,
        arguments.true_effect,
    )
    finish(folder, arguments, comm, progress)
