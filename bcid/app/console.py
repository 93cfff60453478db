"""What a command says and shows: progress, the result, pictures, and what went wrong."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bcid.base.collective import Comm
from bcid.base.errors import MachineError
from bcid.base.progress import Progress, Silent, clear, progress_on
from bcid.base.run_folder import RunFolder
from bcid.base.visible import visible


def complain(text: object) -> None:
    """Say on standard error what went wrong."""
    clear()
    print(f"bcid: {visible(text)}", file=sys.stderr, flush=True)


def tell(text: object) -> None:
    """Say on standard output what a command found."""
    print(visible(text), flush=True)


@contextmanager
def beside_the_result(what: str) -> Iterator[None]:
    """Pages and pictures are a view: what stops them must not take the result along."""
    try:
        yield
    except ImportError as error:
        complain(f"no {what}: {error.name} is not installed (the extra 'report')")
    except Exception as error:
        complain(f"no {what}: {error}")


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Names what is not installed of an extra that a command needs."""
    try:
        yield
    except ImportError as error:
        package = str(error.name).partition(".")[0]
        raise MachineError(f"{package} is not installed: pip install 'bcid[{name}]'") from None


def progress_of(arguments: argparse.Namespace, rank: int) -> Progress:
    """What a command speaks through. One for each command: its lines count the seconds since it was made."""
    return Silent() if arguments.quiet or rank > 0 else progress_on()


def finish(folder: Path, arguments: argparse.Namespace, comm: Comm | None, progress: Progress) -> None:
    """Print the result and draw it; `comm` is None for commands without MPI."""
    if comm is not None and comm.rank > 0:
        return
    print_result(folder, "summary.txt")
    if not arguments.no_picture:
        draw(folder, progress)
    progress.say(f"a page of it: bcid report {folder} -o report.html")


def print_result(folder: Path, file: str) -> None:
    clear()
    tell(RunFolder.open(folder).read_text(file).rstrip())
    tell(f"\nrun folder: {folder}")


def draw(folder: Path, progress: Progress) -> None:
    """Pictures of a run."""
    with beside_the_result("picture"):
        from bcid.report.export import draw_pictures

        for file in draw_pictures(folder):
            progress.say(f"wrote {file}")
