"""Files of a run: pictures in its folder, and `bcid figure`: figures and tables for a paper, and its fields for ParaView."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from matplotlib.figure import Figure

from bcid.base.csv_text import csv_text
from bcid.base.errors import InputError, nearest
from bcid.base.run_folder import write_whole, writing
from bcid.report.figure import encoded, styled
from bcid.report.found import DAMAGE, Found
from bcid.report.gallery import drawings, pictures
from bcid.report.paraview import paraview_files
from bcid.report.provenance import facts
from bcid.report.tables import tables

FORMATS = ("png", "svg", "pdf")
# Dots to an inch, of figures for a paper and of pictures.
_FINE, _PICTURE = 300, 150


def draw_pictures(folder: str | Path) -> list[Path]:
    """Draw the pictures of a finished run into its folder, with `paraview/` where it has a body; returns what was written.

    Raises:
        InputError: the run cannot be read or has nothing to draw.
        MachineError: the folder cannot be written.
    """
    found = _whole(Path(folder))
    with writing(found.path):
        files = _figures(found, pictures(found), ["png"], _PICTURE) | _paraview(found)
        written = [write_whole(found.path / name, content) for name, content in files.items()]
    return [file for file in written if file.name not in ("fiducials.vtkhdf", "patches.vtp")]


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
    found = _whole(folder)
    with _told(found, "a figure"):
        drawn = {drawing.name: drawing.draw for drawing in drawings(found)}
    files = _figures(found, drawn, formats, _FINE, say) | _tables(found)
    if found.body is not None and found.positions is not None:
        say("writing fields for ParaView")
        with _told(found, "fields for ParaView"):
            files |= _paraview(found)
    there = [name for name in sorted(files) if (target / name).exists()]
    if there and not overwrite:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise InputError(f"{target / there[0]}{more}: there already; choose another folder, or add --overwrite")
    with writing(target):
        (target if target.is_dir() else target.parent).mkdir(parents=True, exist_ok=True)
        # On the same disk, so that files are moved there whole.
        beside = target if target.is_dir() else target.parent
        with tempfile.TemporaryDirectory(prefix=".figures-", dir=beside, ignore_cleanup_errors=True) as aside:
            made = Path(aside) / "all"
            for name, content in files.items():
                _beneath(made, name).write_bytes(content)
            if not target.exists():
                # A folder that is not there yet comes whole or not at all.
                made.rename(target)
                return [target / name for name in sorted(files)]
            return [(made / name).replace(_beneath(target, name)) for name in sorted(files)]


def _whole(folder: Path) -> Found:
    """A run that is not damaged."""
    found = Found.read(folder)
    if found.troubles:
        raise InputError("\n".join(found.troubles))
    return found


def _beneath(folder: Path, name: str) -> Path:
    """Path of a file below a folder; the folder that it lies in is made."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _figures(
    found: Found,
    drawn: Mapping[str, Callable[[], Figure]],
    formats: Sequence[str],
    dpi: int,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, bytes]:
    if not drawn:
        raise InputError(
            f"{found.path}: has nothing to draw (bcid {found.command}, {found.state}); give a finished run"
        )
    files: dict[str, bytes] = {}
    for name, draw in drawn.items():
        say(f"drawing {name}")
        with _told(found, f"figure '{name}'"), styled():
            figure = draw()
            files |= {f"{name}.{kind}": encoded(figure, kind, dpi) for kind in formats}
    return files


def _tables(found: Found) -> dict[str, bytes]:
    files = {"provenance.csv": csv_text([("what", "value"), *facts(found)]).encode()}
    for name, _, make in tables(found):
        with _told(found, f"table '{name}'"):
            table = make()
            if table is not None:
                files |= {f"{name}.csv": table.csv().encode(), f"{name}.tex": table.latex().encode()}
    return files


def _paraview(found: Found) -> dict[str, bytes]:
    if found.body is None or found.positions is None:
        return {}
    files = paraview_files(found.body, found.positions, found.anchored)
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
