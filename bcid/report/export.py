"""`bcid figure`: the figures and tables of a run as files for a paper, and its fields for ParaView."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from bcid.base.csv_text import csv_text
from bcid.base.errors import InputError, nearest, unwritable
from bcid.base.run_folder import writing
from bcid.report.figure import styled
from bcid.report.found import Found
from bcid.report.gallery import drawings
from bcid.report.paraview import write_paraview
from bcid.report.provenance import facts
from bcid.report.section import DAMAGE
from bcid.report.svg import svg_bytes
from bcid.report.tables import tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "svg", "pdf")
_FINE = 300


def write_figures(
    folder: Path,
    target: Path,
    formats: Sequence[str] = FORMATS,
    overwrite: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> list[Path]:
    """Write all figures, tables and fields of a run into a folder; returns the files.

    Nothing is written before everything is made: an error leaves the folder as it was.

    Args:
        folder: the run.
        target: made when it is not there.
        formats: of the figures, of `FORMATS`.
        overwrite: replace files of the same names.
        say: told what is being made.

    Raises:
        InputError: the run cannot be read or has nothing to draw, a format is not known, or files are there already.
        MachineError: the folder cannot be written.
    """
    for name in formats:
        if name not in FORMATS:
            raise InputError(f"--format {name}: {nearest(name, FORMATS)}")
    if target.exists() and not target.is_dir():
        raise InputError(f"{target}: is a file; give the name of a folder")
    found = Found.read(folder)
    if found.troubles:
        raise InputError("\n".join(found.troubles))
    with _aside(target) as made:
        _draw(found, made, formats, say)
        _tabulate(found, made)
        _fields(found, made, say)
        names = sorted(path.relative_to(made) for path in made.rglob("*") if path.is_file())
        there = [name for name in names if (target / name).exists()]
        if there and not overwrite:
            more = f" and {len(there) - 1} more" if len(there) > 1 else ""
            raise InputError(f"{target / there[0]}{more}: there already; choose another folder, or add --overwrite")
        return [_moved(made / name, target / name) for name in names]


@contextmanager
def _aside(target: Path) -> Iterator[Path]:
    """A folder beside the target, on the same disk, that is gone in the end."""
    with writing(target):
        parent = target if target.is_dir() else target.parent
        parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=".figures-", dir=parent))
    try:
        yield made
    except OSError as error:
        raise unwritable(target, error) from None
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _moved(source: Path, target: Path) -> Path:
    target.parent.mkdir(parents=True, exist_ok=True)
    return source.replace(target)


def _draw(found: Found, made: Path, formats: Sequence[str], say: Callable[[str], None]) -> None:
    with _told(found, "a figure"):
        chosen = drawings(found)
    if not chosen:
        raise InputError(
            f"{found.path}: has nothing to draw (bcid {found.command}, {found.state}); give a finished run"
        )
    for drawing in chosen:
        say(f"drawing {drawing.name}")
        with _told(found, f"figure '{drawing.name}'"), styled():
            figure = drawing.draw()
            for kind in formats:
                _save(figure, made / f"{drawing.name}.{kind}")


def _save(figure: Figure, target: Path) -> None:
    if target.suffix == ".svg":
        target.write_bytes(svg_bytes(figure, "path"))
        return
    about = {".png": {"Software": None}, ".pdf": {"Creator": None, "Producer": None, "CreationDate": None}}
    figure.savefig(target, dpi=_FINE, metadata=about[target.suffix])


def _tabulate(found: Found, made: Path) -> None:
    with _told(found, "a table"):
        for table in tables(found):
            (made / f"{table.name}.csv").write_text(table.csv(), encoding="utf-8")
            (made / f"{table.name}.tex").write_text(table.latex(), encoding="utf-8")
        (made / "provenance.csv").write_text(csv_text([("what", "value"), *facts(found)]), encoding="utf-8")


def _fields(found: Found, made: Path, say: Callable[[str], None]) -> None:
    if found.body is None or found.positions is None:
        return
    say("writing fields for ParaView")
    anchored = [str(name) for name in found.result.get("anchored", [])]
    with _told(found, "fields for ParaView"):
        write_paraview(made / "paraview", found.body, found.positions, anchored)


@contextmanager
def _told(found: Found, what: str) -> Iterator[None]:
    """Says of damaged content what could not be made of it; a full disk is left to `_aside`."""
    try:
        yield
    except DAMAGE as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise InputError(
            f"{found.path}: {what} cannot be made, its file is damaged or from another version ({error})"
        ) from None
