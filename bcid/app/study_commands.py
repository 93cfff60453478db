"""What `bcid study` does, once its arguments are parsed."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bcid.app.console import print_result, progress_of
from bcid.app.option_values import names_in, part_in
from bcid.base.collective import Comm
from bcid.base.errors import InputError
from bcid.base.progress import Progress
from bcid.base.run_folder import RunFolder

if TYPE_CHECKING:
    from bcid.studies.engine.work import Workers


def study(arguments: argparse.Namespace, comm: Comm | None = None) -> None:
    """`bcid study`."""
    from bcid.studies.engine.work import Workers

    if arguments.jobs < 1:
        raise InputError(f"--jobs {arguments.jobs}: must be at least 1")
    if not arguments.limit > 0:
        raise InputError(f"--limit {arguments.limit:g}: must be a positive number of seconds")
    rank = comm.rank if comm else 0
    folder = _studies(arguments)(
        arguments, Workers(comm, arguments.jobs, arguments.limit), progress_of(arguments, rank)
    )
    if rank == 0 and RunFolder.open(folder).holds("table.txt"):
        print_result(folder, "table.txt")


def _studies(arguments: argparse.Namespace) -> Callable[..., Path]:
    """The function that runs the study that is asked for."""
    named = {"paper": _study_paper, "hidden": _study_hidden, "beyond": _study_beyond, "exploration": _study_exploration}
    if arguments.study in named:
        return named[arguments.study]
    if not Path(arguments.study).is_file():
        raise InputError(f"study '{arguments.study}': neither a file nor one of {', '.join(named)}")
    return _study_file


def _study_hidden(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from bcid.studies.hidden.hidden_study import HiddenOptions, run_hidden

    options = HiddenOptions(
        arguments.cases, arguments.seed, how.jobs, how.limit, arguments.least, conditions=arguments.conditions
    )
    if arguments.bodies is not None:
        options = replace(options, bodies=tuple(name.strip() for name in arguments.bodies.split(",")))
    return run_hidden(arguments.output, options, progress=progress, overwrite=arguments.overwrite, comm=how.comm)


def _study_beyond(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from bcid.studies.beyond.beyond_study import BeyondOptions, run_beyond

    options = BeyondOptions(arguments.cases, arguments.seed)
    if arguments.bodies is not None:
        options = replace(options, bodies=names_in(arguments.bodies))
    return run_beyond(arguments.output, options, how, progress, arguments.overwrite, how.comm)


def _study_exploration(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from bcid.studies.exploration.exploration_study import run_study
    from bcid.studies.exploration.exploration_trials import ExplorationExtent

    count, part = arguments.trials, arguments.only
    extent = ExplorationExtent(count) if part is None else ExplorationExtent.only(count, part)
    return run_study(arguments.output, extent, arguments.seed, how, progress, arguments.overwrite)


def _study_file(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from bcid.studies.paper.study import Extent, run_study

    extent = Extent(arguments.quick, part_in(arguments.part), arguments.predict_only, arguments.seed)
    folder = run_study(Path(arguments.study), arguments.output, extent, how, progress, arguments.overwrite)
    if extent.part or extent.only_predict:
        progress.say("this part is done; the command without --part and --predict-only makes the tables")
    return folder


def _study_paper(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from bcid.studies.paper.paper_study import run_paper

    return run_paper(arguments.output, arguments.quick, arguments.seed, how, progress, arguments.overwrite)
