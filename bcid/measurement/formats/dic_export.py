"""Image correlation, one CSV file for each frame, as VIC-3D, GOM/ARAMIS and MatchID write them: points with their displacements.

The columns are found by their names, or named in [columns] as rest, displacement and point. A point is known by its number, or by
its pixel in the first image (x, y of VIC-3D), else by its row. All but MatchID give the position at rest.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, nearest
from bcid.base.text_file import read_export
from bcid.measurement.formats.foreign import Foreign, How
from bcid.measurement.formats.grid import filled, numbers, read_grid

Array = NDArray[np.float64]

# Lines among which the header is looked for: exports of ARAMIS tell of cameras, calibration and signals before it.
_HEADER = 1000
# MatchID writes the moved position beside the displacement.
_MOVED_PLACE = ("coor.X", "coor.Y", "coor.Z")
_REST = (_MOVED_PLACE, ("X", "Y", "Z"), ("x_undef", "y_undef", "z_undef"), ("x0", "y0", "z0"), ("x", "y", "z"))
_MOVED: tuple[tuple[str, ...], ...] = (
    ("U", "V", "W"),
    ("u", "v", "w"),
    ("displacement_x", "displacement_y", "displacement_z"),
)
_MOVED += (("dX", "dY", "dZ"), ("dx", "dy", "dz"), ("ux", "uy", "uz"))
_MOVED += (("disp.Horizontal Displacement U", "disp.Vertical Displacement V", "disp.Out-Of-Plane: W"),)
_PIXEL = ("Coordinates.Image X", "Coordinates.Image Y")
_POINT = (("id",), ("ID",), ("point_id",), ("index",), _PIXEL, ("x", "y"))
# Bounded, so that no text takes long: a unit in brackets, and a comma within brackets.
_UNIT = re.compile(r"\s{0,8}[\[(](?P<unit>[^\[\]()]{0,64})[\])]\s{0,8}$")
_WITHIN = r"(?![^\[\]]{0,64}\])"


@dataclass(frozen=True)
class _Frame:
    """What tells the points, and whether a column does; rest positions and displacements (points, 3); their unit."""

    keys: list[tuple[float, ...]]
    keyed: bool
    rest: Array
    moved: Array
    unit: str


def recognised(head: str) -> bool:
    """Whether the text begins with a header that names rest positions and displacements."""
    return any(_columns(names) is not None for names in map(_names, head.splitlines()[:_HEADER]))


def read(path: Path, how: How) -> Foreign:
    """One frame; see `read_series`."""
    return read_series([path], how)


def read_series(paths: Sequence[Path], how: How) -> Foreign:
    """The points of files that are a frame each, in their order.

    Raises:
        InputError: a file is cut off, has other columns than the first, or points that cannot be told apart.
    """
    frames = [_frame(path, how) for path in paths]
    keys, rest = frames[0].keys, frames[0].rest.copy()
    number = {key: i for i, key in enumerate(keys)}
    if len(number) < len(keys):
        raise InputError(f"{paths[0]}: holds {len(keys) - len(number)} points twice; export each point once")
    positions = np.full((len(paths), len(keys), 3), np.nan)
    for i, (path, frame) in enumerate(zip(paths, frames, strict=True)):
        if not frame.keyed and len(frame.keys) != len(keys):
            said = (
                f"{path}: has {len(frame.keys)} points, {paths[0].name} has {len(keys)}, and no column tells them apart"
            )
            raise InputError(f"{said}: export the number of each point, and name its column as columns.point")
        known = [(j, number[key]) for j, key in enumerate(frame.keys) if key in number]
        if not known:
            raise InputError(f"{path}: has no point of {paths[0].name}; are they frames of one recording?")
        here, there = np.array(known).T
        positions[i, there] = frame.rest[here] + frame.moved[here]
        # A point that was lost in the first frame is at rest where a later one says.
        rest[there] = np.where(np.isfinite(rest[there]), rest[there], frame.rest[here])
    points = {str(i + 1): positions[:, i] for i in range(len(keys))}
    still = {str(i + 1): rest[i] for i in range(len(keys))}
    times = how.count(len(paths))
    name = f"CSV of image correlation, {len(paths)} file{'s' if len(paths) > 1 else ''}"
    return Foreign(name, times, points, unit=frames[0].unit, numbered=True, clocked=how.rate is not None, rest=still)


def _names(line: str) -> list[str]:
    """Names of columns, without their units."""
    return [_UNIT.sub("", cell) for cell in _cells(line)]


def _cells(line: str) -> list[str]:
    """Names of columns with their units; a comma in brackets, as in F[0,1], is part of a name."""
    cells = re.split(_delimiter(line) + _WITHIN, line.lstrip("#"))
    return [cell.strip().strip('"').strip() for cell in cells]


def _delimiter(line: str) -> str:
    return max(";\t,", key=line.count)


def _columns(names: Sequence[str]) -> tuple[list[str], list[str], list[str]] | None:
    """Columns of the rest position, of the displacement and of what tells a point, in a header."""
    moved = next((list(c) for c in _MOVED if set(c) <= set(names)), None)
    rest = next((list(c) for c in _REST if set(c) <= set(names)), None)
    if moved is None or rest is None:
        return None
    point = next((list(c) for c in _POINT if set(c) <= set(names) and not set(c) & set(rest)), [])
    return rest, moved, point


def _frame(path: Path, how: How) -> _Frame:
    begin = read_export(path)[:_HEADER]
    start = next((i for i, line in enumerate(begin) if _found(_names(line), how)), None)
    if start is None:
        raise InputError(
            f"{path}: no line names rest positions and displacements; name the columns as columns.rest and columns.displacement"
        )
    delimiter, names = _delimiter(begin[start]), _names(begin[start])
    rest, moved, point = _found(names, how) or ([], [], [])
    rows = [row for row in filled(read_grid(path, delimiter)) if row[0] > start + 1]
    for name in (*rest, *moved, *point):
        if name not in names:
            raise InputError(f"{path}:{start + 1}: has no column '{name}'; {nearest(name, names)}")
    used = {names.index(name) for name in (*rest, *moved, *point, "sigma") if name in names}
    values = numbers(path, rows, len(names), "a CSV file of image correlation", used)
    parts = [values[:, [names.index(name) for name in columns]] for columns in (rest, moved)]
    if "sigma" in names:
        # VIC-3D marks points that were not correlated by a sigma of -1: what else is in their rows is no position.
        lost = values[:, [names.index("sigma")]] < 0
        parts = [np.where(lost, np.nan, part) for part in parts]
    if tuple(rest) == _MOVED_PLACE:
        parts[0] = parts[0] - parts[1]
    told = values[:, [names.index(name) for name in point]] if point else np.arange(len(rows))[:, None]
    keys: list[tuple[float, ...]] = [tuple(map(float, row)) for row in told]
    return _Frame(keys, bool(point), parts[0], parts[1], _unit(begin[start], rest[0]))


def _found(names: list[str], how: How) -> tuple[list[str], list[str], list[str]] | None:
    told = how.columns
    if "rest" in told and "displacement" in told:
        whole = set(told["rest"]) | set(told["displacement"])
        point = [told["point"]] if "point" in told else []
        return (list(told["rest"]), list(told["displacement"]), point) if whole & set(names) else None
    return _columns(names)


def _unit(line: str, name: str) -> str:
    """The unit that the header states for a column; "" if none."""
    for text in _cells(line):
        match = _UNIT.search(text)
        if match and _UNIT.sub("", text) == name:
            return match["unit"]
    return ""
