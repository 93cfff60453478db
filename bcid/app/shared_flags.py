"""Flags that several commands have, and what their values are read as."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bcid.app.flags import add_flags, names_in
from bcid.base.errors import InputError
from bcid.base.options import ExplainOptions


def add_command(
    commands: Any, name: str, run: Callable[..., Any], help_text: str, more: str = ""
) -> argparse.ArgumentParser:
    """Declare a command with what runs it and its help; returns its parser."""
    raw = argparse.RawDescriptionHelpFormatter
    text = help_text[0].upper() + help_text[1:] + ".\n\n" + more
    parser: argparse.ArgumentParser = commands.add_parser(name, help=help_text, description=text, formatter_class=raw)
    parser.set_defaults(run=run)
    return parser


def add_run(parser: argparse.ArgumentParser) -> None:
    """The run folder to write."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="RUN", help="run folder to write")


def add_output(parser: argparse.ArgumentParser, picture: bool = True) -> None:
    """How a run folder is written."""
    parser.add_argument("--overwrite", action="store_true", help="discard a run that the folder already holds")
    if picture:
        parser.add_argument("--no-picture", action="store_true", help="do not draw pictures and write ParaView files")
    add_quiet(parser)


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """Whether to say only the result."""
    parser.add_argument("--quiet", action="store_true", help="say only the result")


def add_inputs(parser: argparse.ArgumentParser) -> None:
    """What a run without an earlier one starts from, and where it goes."""
    parser.add_argument(
        "scene", type=Path, help="scene file (TOML): body, mesh ladder, candidate patches, grasps, fiducials"
    )
    parser.add_argument(
        "measurement", type=Path, help="measurement folder, NetCDF file, or mapping file of a recording (bcid import)"
    )
    add_run(parser)


def add_source(parser: argparse.ArgumentParser) -> None:
    """A run to start from, and what all jobs on one have in common."""
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="run folder of identify, diagnose, fit or explain")
    add_store(parser)
    add_flags(parser, ExplainOptions, ("level",))
    add_effect_files(parser)
    add_output(parser)


def add_store(parser: argparse.ArgumentParser) -> None:
    """Where predictions are kept."""
    parser.add_argument(
        "--store",
        type=Path,
        metavar="FOLDER",
        help="for predictions, shared by runs (in the run folder, until it ends)",
    )


def add_effect_files(parser: argparse.ArgumentParser) -> None:
    """Files with effects of one's own."""
    parser.add_argument(
        "--effects",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="Python file with an effect of your own (docs/effects.md); it is run. May be given several times",
    )


def all_names(given: Sequence[str]) -> list[str]:
    """Names of an option that may be repeated, and each time give several separated by commas."""
    return [name for text in given for name in names_in(text)]


def direction_in(text: str | None) -> tuple[float, ...] | None:
    """Three numbers separated by commas or blanks; None where the option is not given."""
    if text is None:
        return None
    try:
        return tuple(float(number) for number in text.replace(",", " ").split())
    except ValueError:
        raise InputError(f"--direction '{text}': expected three numbers, as 0,0,1") from None
