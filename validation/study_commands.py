"""The studies of `bcid-validate`: made-up bodies and measurements, over ranks or child processes, and the benchmark of speed."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from bcid.app.console import print_result, progress_of
from bcid.app.flags import names_in, seed
from bcid.app.shared_flags import add_command, add_output, add_run
from bcid.base.collective import Comm
from bcid.base.errors import InputError
from bcid.base.progress import Progress
from bcid.base.run_folder import RunFolder
from validation.engine.work import Workers

# Studies whose trials may be made by the ranks of an MPI job.
STUDIES = ("paper", "study", "synthetic", "beyond", "exploration")
_MORE = (
    "Under mpirun the ranks make the trials, rank 0 hands them out; else child processes do. A study that was stopped,\n"
    "in whatever way, goes on where it was when the same command is given again. See docs/study.md."
)


def add_studies(parts: Any) -> None:
    """Declare the studies and the benchmark."""
    paper = _study(parts, "paper", _paper, "every table and figure of the paper", "of what is random (0)")
    one = _study(parts, "study", _file, "one table of the paper, or one of your own", "of what is random (0)")
    one.add_argument("file", type=Path, metavar="FILE", help="study file (TOML), see validation/paper/")
    one.add_argument("--part", metavar="I/N", help="every N-th trial from the I-th, as one of N jobs on a run folder")
    one.add_argument("--predict-only", action="store_true", help="only what all trials share")
    for parser in (paper, one):
        parser.add_argument("--quick", action="store_true", help="the reduced study")
    synthetic = _study(
        parts,
        "synthetic",
        _synthetic,
        "hide effects in measurements, and score blind diagnoses of them",
        "of the cases (0)",
    )
    synthetic.add_argument(
        "--least", type=float, default=0.5, metavar="SIZE", help="of an effect, in units of noise (0.5)"
    )
    synthetic.add_argument(
        "--conditions",
        choices=("all", "exact", "inexact", "forces"),
        default="all",
        help="everything as the scene states it, everything but the noise slightly wrong, both with forces, or all other "
        "conditions in turns (all)",
    )
    beyond = _study(
        parts, "beyond", _beyond, "hide laws and effects that no catalogue has, and score proposals", "of the cases (0)"
    )
    for parser in (synthetic, beyond):
        parser.add_argument("--cases", type=int, default=400, metavar="N", help="number of cases (400)")
        parser.add_argument("--bodies", metavar="NAMES", help="that take turns, as slab,finger (with gallbladder all)")
    exploration = _study(
        parts, "exploration", _exploration, "how many pulls does it take to know the anchors?", "of the trials (0)"
    )
    exploration.add_argument("--trials", type=int, default=30, metavar="N", help="of each setting (30)")
    exploration.add_argument("--only", choices=("main", "hidden", "enclosed", "forces"), help="one part of it (all)")
    bench = add_command(
        parts,
        "bench",
        _bench,
        "measure speed against other codes, goals and limits",
        "Prints a table per part; writes bench.json and plots. See docs/bench.md.",
    )
    bench.add_argument(
        "parts", nargs="*", metavar="PART", help="trajectory, toggles, identification, explain, explore, growth (all)"
    )
    bench.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="folder to write")
    bench.add_argument("--quick", action="store_true", help="a reduced form of each part, without a network")


def _study(
    parts: Any, name: str, run: Callable[[argparse.Namespace, Workers, Progress], Path], about: str, of_seed: str
) -> argparse.ArgumentParser:
    """The parser of a study, with what all of them take."""
    parser = add_command(parts, name, lambda arguments, comm=None: _run(run, arguments, comm), about, _MORE)
    add_run(parser)
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes at a time without mpirun (2)")
    parser.add_argument(
        "--limit", type=float, default=900.0, metavar="SECONDS", help="CPU seconds that a trial may take (900)"
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help=of_seed)
    add_output(parser, picture=False)
    return parser


def _run(
    study: Callable[[argparse.Namespace, Workers, Progress], Path], arguments: argparse.Namespace, comm: Comm | None
) -> None:
    """Run a study, and print its table."""
    if arguments.jobs < 1:
        raise InputError(f"--jobs {arguments.jobs}: must be at least 1")
    if not arguments.limit > 0:
        raise InputError(f"--limit {arguments.limit:g}: must be a positive number of seconds")
    rank = comm.rank if comm else 0
    folder = study(arguments, Workers(comm, arguments.jobs, arguments.limit), progress_of(arguments, rank))
    if rank == 0 and RunFolder.open(folder).holds("table.txt"):
        print_result(folder, "table.txt")


def _paper(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from validation.paper.paper_study import run_paper

    return run_paper(arguments.output, arguments.quick, arguments.seed, how, progress, arguments.overwrite)


def _file(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from validation.paper.study import Extent, run_study

    extent = Extent(arguments.quick, _part_in(arguments.part), arguments.predict_only, arguments.seed)
    folder = run_study(arguments.file, arguments.output, extent, how, progress, arguments.overwrite)
    if extent.part or extent.only_predict:
        progress.say("this part is done; the command without --part and --predict-only makes the tables")
    return folder


def _synthetic(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from validation.synthetic.hidden_study import HiddenOptions, run_hidden

    options = HiddenOptions(
        arguments.cases, arguments.seed, how.jobs, how.limit, arguments.least, conditions=arguments.conditions
    )
    if arguments.bodies is not None:
        options = replace(options, bodies=names_in(arguments.bodies))
    return run_hidden(arguments.output, options, progress=progress, overwrite=arguments.overwrite, comm=how.comm)


def _beyond(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from validation.beyond.beyond_study import BeyondOptions, run_beyond

    options = BeyondOptions(arguments.cases, arguments.seed)
    if arguments.bodies is not None:
        options = replace(options, bodies=names_in(arguments.bodies))
    return run_beyond(arguments.output, options, how, progress, arguments.overwrite, how.comm)


def _exploration(arguments: argparse.Namespace, how: Workers, progress: Progress) -> Path:
    from validation.exploration.exploration_study import run_study
    from validation.exploration.exploration_trials import ExplorationExtent

    count, part = arguments.trials, arguments.only
    extent = ExplorationExtent(count) if part is None else ExplorationExtent.only(count, part)
    return run_study(arguments.output, extent, arguments.seed, how, progress, arguments.overwrite)


def _bench(arguments: argparse.Namespace) -> None:
    from validation.bench.bench_run import run

    run(arguments.parts, arguments.output, arguments.quick)


def _part_in(text: str | None) -> tuple[int, int] | None:
    """(i, n) of "i/n"."""
    if text is None:
        return None
    numbers = text.split("/")
    if len(numbers) == 2 and all(n.isdecimal() for n in numbers) and 1 <= int(numbers[0]) <= int(numbers[1]):
        return int(numbers[0]), int(numbers[1])
    raise InputError(f"--part '{text}': expected I/N with I from 1 to N, as 3/16")
