"""Image or volume correlation, a CSV file for each frame, as VIC-3D, GOM/ARAMIS and MatchID write them: points with displacements.

The columns are found by their names, or named in [columns] as rest, displacement, point, step and quality. A point is known by its
number, or by its pixel in the first image (x, y of VIC-3D), else by its row where all frames have the same, else by where it is at
rest. All but MatchID give the position at rest. A single file with a column of steps has all frames, one below the other.
"""

from __future__ import annotations

import re
from collections.abc import Mapping as Table
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from bcid.base.errors import InputError, nearest
from bcid.base.text_file import read_export
from bcid.measurement.formats.foreign import Export, Foreign, How

Array = NDArray[np.float64]

# Lines among which the header is looked for: exports of ARAMIS tell of cameras, calibration and signals before it.
_HEADER = 1000
# MatchID writes the moved position beside the displacement.
_MOVED_PLACE = ("coor.X", "coor.Y", "coor.Z")
# Capitals count: in VIC-3D X, Y, Z are places, and x, y are pixels.
_REST_NAMES = ("X Y Z", "x_undef y_undef z_undef", "x0 y0 z0", "X0 Y0 Z0", "pos_x pos_y pos_z", "x y z")
_REST = (_MOVED_PLACE, *(tuple(names.split()) for names in _REST_NAMES))
_MOVED_NAMES = ["U V W", "u v w", "displacement_x displacement_y displacement_z", "dX dY dZ", "dx dy dz", "ux uy uz"]
_MOVED_NAMES += ("Ux Uy Uz", "UX UY UZ", "disp_x disp_y disp_z", "u_x u_y u_z")
_MATCHID = ("disp.Horizontal Displacement U", "disp.Vertical Displacement V", "disp.Out-Of-Plane: W")
_MOVED = (*(tuple(names.split()) for names in _MOVED_NAMES), _MATCHID)
_PIXEL = ("Coordinates.Image X", "Coordinates.Image Y")
_POINT = (("id",), ("ID",), ("point_id",), ("index",), _PIXEL, ("x", "y"))
# How well a point was correlated: 1 is best, and 0 that it was not.
_QUALITY = ("corr", "zncc", "ncc", "cc", "correlation", "quality")
_STEP = ("step", "frame", "state", "stage", "load_step", "loadstep")
# Rest positions are the same within this part of the distance between neighbours.
_SAME = 0.02
# Bounded, so that no text takes long: a unit in brackets, and a comma within brackets.
_UNIT = re.compile(r"\s{0,8}[\[(](?P<unit>[^\[\]()]{0,64})[\])]\s{0,8}$")
_WITHIN = r"(?![^\[\]]{0,64}\])"


@dataclass(frozen=True)
class _Frame:
    """What tells the points, and whether a column does; rest positions and displacements (points, 3); their unit.

    `name` is the frame's in messages; `quality` (points,) is None where the file has none.
    """

    name: str
    keys: list[tuple[float, ...]]
    keyed: bool
    rest: Array
    moved: Array
    unit: str
    quality: Array | None

    def part(self, step: float, rows: NDArray[np.int64]) -> _Frame:
        """The frame of a step, in which points without a number are counted anew."""
        keys = [self.keys[j] for j in rows] if self.keyed else [(float(j),) for j in range(len(rows))]
        quality = None if self.quality is None else self.quality[rows]
        name, rest, moved = f"{self.name}: step {step:g}", self.rest[rows], self.moved[rows]
        return replace(self, name=name, keys=keys, rest=rest, moved=moved, quality=quality)


def recognised(head: str) -> bool:
    """Whether the text begins with a header that names rest positions and displacements."""
    return any(_columns(names, {}) is not None for names in map(_names, head.splitlines()[:_HEADER]))


def read_series(paths: Sequence[Path], how: How) -> Foreign:
    """The points of files that are a frame each, in their order.

    Raises:
        InputError: a file is cut off, has other columns than the first, or points that cannot be told apart.
    """
    frames = _steps(paths[0], how) if len(paths) == 1 else [_read(path, how)[0] for path in paths]
    keys, rest = frames[0].keys, frames[0].rest.copy()
    number = {key: i for i, key in enumerate(keys)}
    if len(number) < len(keys):
        what = "a column of steps would tell its frames apart, as columns.step; otherwise export each point once"
        raise InputError(f"{frames[0].name}: holds {len(keys) - len(number)} points twice; {what}")
    positions = np.full((len(frames), len(keys), 3), np.nan)
    quality = np.full((len(frames), len(keys)), np.nan)
    for i, frame in enumerate(frames):
        if frame.keyed:
            known = [(j, number[key]) for j, key in enumerate(frame.keys) if key in number]
            if not known:
                raise InputError(f"{frame.name}: has no point of {frames[0].name}; are they frames of one recording?")
            here, there = np.array(known).T
        else:
            here, there = _same_places(frames[0], frame)
        positions[i, there] = frame.rest[here] + frame.moved[here]
        quality[i, there] = np.nan if frame.quality is None else frame.quality[here]
        # A point that was lost in the first frame is at rest where a later one says.
        rest[there] = np.where(np.isfinite(rest[there]), rest[there], frame.rest[here])
    points = {str(i + 1): positions[:, i] for i in range(len(keys))}
    still = {str(i + 1): rest[i] for i in range(len(keys))}
    name = f"CSV of image correlation, {len(paths)} file{'s' if len(paths) > 1 else ''}"
    found = Foreign(name, how.count(len(frames)), points, unit=frames[0].unit, rest=still)
    found = replace(found, numbered=True, clocked=how.rate is not None, displacements=True)
    return found.correlated(quality) if any(frame.quality is not None for frame in frames) else found


def _same_places(first: _Frame, frame: _Frame) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of a frame, and of the first one, that have the same rest positions.

    Raises:
        InputError: of most points there is none.
    """
    known = np.flatnonzero(np.isfinite(first.rest).all(axis=1))
    own = np.flatnonzero(np.isfinite(frame.rest).all(axis=1))
    if len(first.rest) == len(frame.rest) and (len(known) < 2 or len(own) < 2):
        return np.arange(len(first.rest)), np.arange(len(first.rest))
    tree = cKDTree(first.rest[known])
    spacing = float(np.median(tree.query(first.rest[known], k=2)[0][:, 1])) if len(known) > 1 else 0.0
    if len(first.rest) == len(frame.rest):
        away = np.linalg.norm(frame.rest - first.rest, axis=1)
        if not (away > _SAME * spacing).any():
            return np.arange(len(away)), np.arange(len(away))
    distance, nearest_one = tree.query(frame.rest[own])
    same = distance <= _SAME * spacing
    if 2 * same.sum() < len(own) or len(set(nearest_one[same])) < same.sum():
        raise InputError(
            f"{frame.name}: has {len(frame.keys)} points, {first.name} has {len(first.keys)}, and only {same.sum()} stand "
            "where one of those stands at rest, and no column tells them apart: export positions without the displacement, or the "
            "number of each point, and name its column as columns.point"
        )
    return own[same], known[nearest_one[same]]


def lacking(head: str) -> str:
    """What a header of displacements lacks, in words; "" of one that lacks nothing, or is no such header."""
    for names in map(_names, head.splitlines()[:_HEADER]):
        places = next((c for c in _REST if set(c) <= set(names)), None)
        for moved in _MOVED:
            there = [name for name in moved if name in names]
            if places and len(there) == 2 and not set(there) & set(places):
                missing = next(name for name in moved if name not in names)
                what = f"it has the displacements {' and '.join(there)}, but no {missing}"
                return f"{what}; export all three, or make a table of positions without the one that was not measured"
            if len(there) == 3 and places is None:
                what = f"it has the displacements {', '.join(there)}, but no positions at rest, as x, y, z"
                return f"{what}; export where the points are without displacement"
    return ""


def _names(line: str) -> list[str]:
    """Names of columns, without their units."""
    return [_UNIT.sub("", cell) for cell in _cells(line)]


def _cells(line: str) -> list[str]:
    """Names of columns with their units; a comma in brackets, as in F[0,1], is part of a name."""
    cells = re.split(_delimiter(line) + _WITHIN, line.lstrip("#"))
    return [cell.strip().strip('"').strip() for cell in cells]


def _delimiter(line: str) -> str:
    return max(";\t,", key=line.count)


def _columns(names: Sequence[str], told: Table[str, Any]) -> tuple[list[str], list[str], list[str]] | None:
    """Columns of the rest position, of the displacement and of what tells a point, in a header; `told`: those of a mapping."""
    if "rest" in told and "displacement" in told:
        whole = set(told["rest"]) | set(told["displacement"])
        point = [told["point"]] if "point" in told else []
        return (list(told["rest"]), list(told["displacement"]), point) if whole & set(names) else None
    moved = next((list(c) for c in _MOVED if set(c) <= set(names)), None)
    rest = next((list(c) for c in _REST if set(c) <= set(names)), None)
    if moved is None or rest is None:
        return None
    point = next((list(c) for c in _POINT if set(c) <= set(names) and not set(c) & set(rest)), [])
    return rest, moved, point


def _steps(path: Path, how: How) -> list[_Frame]:
    """The frames of one file, which is one where no column has their steps."""
    frame, step = _read(path, how)
    if step is None:
        return [frame]
    if not np.isfinite(step).all():
        raise InputError(f"{path}: {int((~np.isfinite(step)).sum())} rows have no step; expected a number in each")
    return [frame.part(value, np.flatnonzero(step == value)) for value in dict.fromkeys(map(float, step))]


def _read(path: Path, how: How) -> tuple[_Frame, Array | None]:
    """The rows of a file, and the step of each where a column has that."""
    begin = read_export(path)[:_HEADER]
    start = next((i for i, line in enumerate(begin) if _columns(_names(line), how.columns)), None)
    if start is None:
        raise InputError(
            f"{path}: no line names rest positions and displacements; name the columns as columns.rest and columns.displacement"
        )
    delimiter, names = _delimiter(begin[start]), _names(begin[start])
    rest, moved, point = _columns(names, how.columns) or ([], [], [])
    export = Export.read(path, delimiter, "a CSV file of image correlation")
    rows = [row for row in export.rows if row[0] > start + 1]
    step = _one_of(names, how.columns.get("step"), _STEP)
    good = _one_of(names, how.columns.get("quality"), _QUALITY)
    for name in (*rest, *moved, *point, *step, *good):
        if name not in names:
            raise InputError(f"{path}:{start + 1}: has no column '{name}'; {nearest(name, names)}")
    used = {names.index(name) for name in (*rest, *moved, *point, *step, *good, "sigma") if name in names}
    values = export.numbers(rows, len(names), used)
    parts = [values[:, [names.index(name) for name in columns]] for columns in (rest, moved)]
    if "sigma" in names:
        # VIC-3D marks points that were not correlated by a sigma of -1: what else is in their rows is no position.
        lost = values[:, [names.index("sigma")]] < 0
        parts = [np.where(lost, np.nan, part) for part in parts]
    if tuple(rest) == _MOVED_PLACE:
        parts[0] = parts[0] - parts[1]
    told = values[:, [names.index(name) for name in point]] if point else np.arange(len(rows))[:, None]
    keys: list[tuple[float, ...]] = [tuple(map(float, row)) for row in told]
    quality = values[:, names.index(good[0])] if good else None
    frame = _Frame(str(path), keys, bool(point), parts[0], parts[1], _unit(begin[start], rest[0]), quality)
    return frame, values[:, names.index(step[0])] if step else None


def _one_of(names: list[str], told: str | None, usual: Sequence[str]) -> list[str]:
    """The column that a mapping names, or one with a usual name; none where there is none."""
    return [told] if told is not None else [name for name in names if name.lower() in usual][:1]


def _unit(line: str, name: str) -> str:
    """The unit that the header states for a column; "" if none."""
    for text in _cells(line):
        match = _UNIT.search(text)
        if match and _UNIT.sub("", text) == name:
            return match["unit"]
    return ""
