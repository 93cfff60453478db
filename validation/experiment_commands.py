"""The experiments of `bcid-validate`: golden, ablation, numbers, calibration, outside, public. Each goes on where it was."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bcid.app.shared_flags import add_command
from bcid.base.progress import progress_on
from validation.golden.cases import CASES
from validation.outside.worlds import CASES as CASES_OF_KIND
from validation.outside.worlds import KINDS
from validation.stored_results import cut, keep

# Golden cases of few seconds each.
QUICK = ["awkward-six-markers", "hidden-211-4", "hidden-223-5"]


def add_experiments(parts: Any) -> None:
    """Declare the experiments."""
    golden = _part(parts, "golden", _golden, "explain the golden cases, and compare the answers with the frozen ones")
    golden.add_argument("--only", nargs="+", choices=list(CASES), metavar="CASE", help="some cases (all)")
    golden.add_argument("--freeze", action="store_true", help="make these answers the frozen ones")
    ablation = _part(
        parts, "ablation", _ablation, "explain golden cases without one term of the posterior after the other"
    )
    ablation.add_argument("--only", nargs="+", choices=list(CASES), metavar="CASE", help="some cases (all)")
    numbers = _part(
        parts, "numbers", _numbers, "explain golden cases with half and double of each number that decides something"
    )
    numbers.add_argument(
        "--only", nargs="+", choices=list(CASES), default=QUICK, metavar="CASE", help=f"some cases ({' '.join(QUICK)})"
    )
    outside = _part(
        parts, "outside", _outside, "explain worlds of an independent code that are outside the family of models"
    )
    outside.add_argument("--kinds", nargs="+", choices=list(KINDS), metavar="KIND", help=f"of {', '.join(KINDS)} (all)")
    outside.add_argument(
        "--cases", type=_count, default=CASES_OF_KIND, metavar="N", help=f"of each kind ({CASES_OF_KIND})"
    )
    outside.add_argument("--freeze", action="store_true", help="keep these inputs in the repository")
    for one in (golden, ablation, numbers, outside):
        one.add_argument("--jobs", type=_count, default=2, metavar="N", help="processes at a time (2)")
        one.add_argument("--store", type=Path, metavar="FOLDER", help="keep predictions here, for other runs")
    calibration = _part(
        parts, "calibration", _calibration, "draw data from the linearised model, and compare answers with the truth"
    )
    calibration.add_argument(
        "--draws", type=_count, default=1000, metavar="N", help="with each level of the noise (1000)"
    )
    public = _part(parts, "public", _public, "answer measurements made by others, beside what their authors say")
    public.add_argument("folder", type=Path, metavar="FOLDER", help="with the data of others, as human_skin")


def _part(parts: Any, name: str, run: Callable[[argparse.Namespace], None], about: str) -> argparse.ArgumentParser:
    """The parser of an experiment, with what all of them take."""
    parser = add_command(parts, name, run, about)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="RUN", help="folder; a run in it goes on")
    parser.add_argument("--keep", action="store_true", help="keep the result in the repository, for the documentation")
    return parser


def _keep(chosen: argparse.Namespace, result: Any) -> None:
    """Keep the result of an experiment where that is wanted."""
    if chosen.keep:
        print(f"kept in {keep(chosen.command, result)}")


def _golden(chosen: argparse.Namespace) -> None:
    from validation.golden import run
    from validation.golden.score import text

    run.run(chosen.output, chosen.only or list(CASES), chosen.jobs, progress_on(), chosen.store)
    if chosen.freeze:
        print(f"{run.freeze(chosen.output)} answers are frozen in {run.ANSWERS}")
    found = run.read(chosen.output)
    print(text(run.frozen(), found))
    _keep(chosen, {name: cut(answer) for name, answer in found.items()})


def _ablation(chosen: argparse.Namespace) -> None:
    from validation import ablation

    store = chosen.store or chosen.output / "store"
    ablation.run(chosen.output, chosen.only or list(CASES), chosen.jobs, store, progress_on())
    found = ablation.read(chosen.output)
    print(ablation.table(found).text())
    _keep(chosen, {term: {name: cut(one) for name, one in answers.items()} for term, answers in found.items()})


def _numbers(chosen: argparse.Namespace) -> None:
    from validation import numbers

    store = chosen.store or chosen.output / "store"
    numbers.run(chosen.output, chosen.only, chosen.jobs, store, progress_on())
    found = numbers.read(chosen.output)
    print(numbers.table(found).text())
    _keep(chosen, {word: {name: cut(one) for name, one in answers.items()} for word, answers in found.items()})


def _calibration(chosen: argparse.Namespace) -> None:
    from validation import calibration

    calibration.run(chosen.output, chosen.draws, progress_on())
    found = calibration.read(chosen.output)
    print(calibration.table(found).text())
    print(calibration.picture(found, chosen.output / "calibration.png"))
    _keep(chosen, found)


def _outside(chosen: argparse.Namespace) -> None:
    from validation.outside import run
    from validation.outside.score import text

    run.run(chosen.output, chosen.kinds or list(KINDS), chosen.cases, chosen.jobs, progress_on(), chosen.store)
    if chosen.freeze:
        print(f"{run.freeze(chosen.output)} inputs are kept in {run.INPUTS}")
    found = run.read(chosen.output)
    print(text(found))
    _keep(chosen, {name: cut(answer) for name, answer in found.items()})


def _public(chosen: argparse.Namespace) -> None:
    from validation import public

    rows = public.run(chosen.folder, chosen.output, progress_on())
    print(public.table(rows).text())
    _keep(chosen, rows)


def _count(word: str) -> int:
    if not word.isdecimal() or int(word) < 1:
        raise argparse.ArgumentTypeError(f"needs a whole number from 1 on, found '{word}'")
    return int(word)
