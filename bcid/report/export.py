"""`bcid figure`: the figures and tables of a run as files for a paper, and its fields for ParaView."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from bcid.base.csv_text import csv_text
from bcid.base.errors import InputError, nearest
from bcid.base.run_folder import writing
from bcid.report.figure import styled
from bcid.report.found import Found
from bcid.report.gallery import drawings
from bcid.report.paraview import paraview_files
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

    Everything is made, then written beside the folder, then moved there: an error leaves the folder as it was.

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
    files = {**_figures(found, formats, say), **_tables(found), **_fields(found, say)}
    there = [name for name in sorted(files) if (target / name).exists()]
    if there and not overwrite:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise InputError(f"{target / there[0]}{more}: there already; choose another folder, or add --overwrite")
    with writing(target), _aside(target) as made:
        for name, content in files.items():
            _beneath(made / "all", name).write_bytes(content)
        if not target.exists():
            (made / "all").rename(target)
            return [target / name for name in sorted(files)]
        return [(made / "all" / name).replace(_beneath(target, name)) for name in sorted(files)]


@contextmanager
def _aside(target: Path) -> Iterator[Path]:
    """A folder beside the target, on the same disk, that is gone in the end."""
    parent = target if target.is_dir() else target.parent
    parent.mkdir(parents=True, exist_ok=True)
    made = Path(tempfile.mkdtemp(prefix=".figures-", dir=parent))
    try:
        yield made
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _beneath(folder: Path, name: str) -> Path:
    """Path of a file below a folder; the folder that it lies in is made."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _figures(found: Found, formats: Sequence[str], say: Callable[[str], None]) -> dict[str, bytes]:
    with _told(found, "a figure"):
        chosen = drawings(found)
    if not chosen:
        raise InputError(
            f"{found.path}: has nothing to draw (bcid {found.command}, {found.state}); give a finished run"
        )
    files = {}
    for drawing in chosen:
        say(f"drawing {drawing.name}")
        with _told(found, f"figure '{drawing.name}'"), styled():
            figure = drawing.draw()
            for kind in formats:
                files[f"{drawing.name}.{kind}"] = _content(figure, kind)
    return files


def _content(figure: Figure, kind: str) -> bytes:
    if kind == "svg":
        return svg_bytes(figure, "path")
    about = {"png": {"Software": None}, "pdf": {"Creator": None, "Producer": None, "CreationDate": None}}
    stream = BytesIO()
    figure.savefig(stream, format=kind, dpi=_FINE, metadata=about[kind])
    return stream.getvalue()


def _tables(found: Found) -> dict[str, bytes]:
    files = {}
    with _told(found, "a table"):
        for table in tables(found):
            files[f"{table.name}.csv"] = table.csv().encode()
            files[f"{table.name}.tex"] = table.latex().encode()
        files["provenance.csv"] = csv_text([("what", "value"), *facts(found)]).encode()
    return files


def _fields(found: Found, say: Callable[[str], None]) -> dict[str, bytes]:
    if found.body is None or found.positions is None:
        return {}
    say("writing fields for ParaView")
    anchored = [str(name) for name in found.result.get("anchored", [])]
    with _told(found, "fields for ParaView"):
        files = paraview_files(found.body, found.positions, anchored)
    return {f"paraview/{name}": content for name, content in files.items()}


@contextmanager
def _told(found: Found, what: str) -> Iterator[None]:
    """Says of damaged content what could not be made of it."""
    try:
        yield
    except DAMAGE as error:
        raise InputError(
            f"{found.path}: {what} cannot be made, its file is damaged or from another version ({error})"
        ) from None
