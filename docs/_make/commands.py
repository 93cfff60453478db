"""The reference of all commands, from the parser itself."""

import argparse
import os
from pathlib import Path

from bcid.app.cli import build_parser


def write_commands(target: Path) -> None:
    """Write the help of every command as Markdown."""
    # Help is wrapped to the width of the terminal.
    os.environ["COLUMNS"], os.environ["NO_COLOR"] = "110", "1"
    parser = build_parser()
    parts = ["# Commands", "", "Any of them runs under `mpirun -n N`.", "", *block(parser)]
    for name, command in subcommands(parser).items():
        parts += [f"## bcid {name}", "", *block(command)]
        for action, inner in subcommands(command).items():
            parts += [f"### bcid {name} {action}", "", *block(inner)]
    text = "\n".join(parts)
    if not target.is_file() or target.read_text(encoding="utf-8") != text:
        target.write_text(text, encoding="utf-8")


def block(parser: argparse.ArgumentParser) -> list[str]:
    """The help of a parser as a block of text."""
    return ["```text", parser.format_help().rstrip(), "```", ""]


def subcommands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The parsers of the commands, by name; none where there are none."""
    found = [action.choices for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(found[0]) if found else {}
