"""What the columns of a table, or the arrays of a MAT, HDF5 or NPZ file, are: guessed from names and shapes."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError
from bcid.base.text_file import read_lines
from bcid.measurement.formats.array_file import ArrayFile, look, shown

# A name and its axis: tip_x, tip.X, "tip x [mm]", tip_x_mm, x_tip.
_BEHIND = re.compile(r"(?P<name>.*[^\s_.:-])?[\s_.:-]*(?P<axis>[xyzXYZ])")
_BEFORE = re.compile(r"(?P<axis>[xyzXYZ])[\s_.:-]+(?P<name>.+)")
_UNIT = re.compile(r"\s*[\[(](?P<unit>[^\])]*)[\])]\s*$")
_UNIT_BEHIND = re.compile(r"(?<=[xyzXYZ])_(?P<unit>mm|cm|um|m|in)$|(?<=^t)_s$|(?<=^time)_s$")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_NAMES = {
    "time": ("t", "time", "timestamp", "seconds", "zeit"),
    "action": ("action", "trial", "run"),
    "step": ("step", "frame", "state", "stage", "k"),
    "fiducial": ("fiducial", "marker", "label", "name", "point"),
    "grasp": ("grasp",),
}
_WRENCH = (("fx", "fy", "fz", "tx", "ty", "tz"), ("fx", "fy", "fz", "mx", "my", "mz"))
_ROTATION = ("qw", "qx", "qy", "qz")
# Triples of these are no markers.
_NO_MARKERS = ("q", "f", "t", "m", "rot", "force", "torque")

Shape = tuple[int, ...]

# Displacements of Ncorr, and what it says of its grid.
_NCORR = "data_dic_save/displacements/plot_{}_ref_formatted"
_NCORR_GRID = ("data_dic_save/dispinfo/pixtounits", "data_dic_save/dispinfo/spacing")
# Arrays that hold positions are often called so; others with three columns are faces, normals and the like.
_POSITIONS = ("position", "points3d", "xyz", "marker", "point", "traj", "pos", "coord")
_OTHERS = ("face", "normal", "color", "colour", "vector", "disp", "force", "strain", "unit")
# Names of the three components, and of one array of all, in lower case; so of rest positions.
_MOVED = (
    "u v w",
    "ux uy uz",
    "u_x u_y u_z",
    "disp_x disp_y disp_z",
    "dx dy dz",
    "displacement_x displacement_y displacement_z",
)
_MOVED_ALL = ("displacement", "displacements", "disp", "u")
_REST = ("x y z", "x0 y0 z0", "pos_x pos_y pos_z", "grid_x grid_y grid_z")
_REST_ALL = (
    "points",
    "point",
    "positions",
    "position",
    "rest",
    "reference",
    "coords",
    "coordinates",
    "xyz",
    "nodes",
    "x",
)
_QUALITY = ("corr", "zncc", "ncc", "cc", "correlation", "quality")

_TIMES = ("t", "time", "times", "timestamp", "timestamps")


def guess_delimiter(lines: Sequence[str]) -> str:
    """The sign that divides the header into most columns."""
    header = lines[0] if lines else ""
    return max(";\t,", key=lambda sign: len(next(csv.reader([header], delimiter=sign), [])))


def guess_table(path: Path) -> dict[str, Any]:
    """Keys of a mapping for a table of text: delimiter, decimal, columns, fiducials, and units that the header states.

    Raises:
        InputError: it is no text.
    """
    lines = read_lines(path)[:50]
    delimiter = guess_delimiter(lines)
    rows = list(csv.reader(lines, delimiter=delimiter))
    told = guess_columns([name.strip() for name in rows[0]] if rows else [])
    if delimiter != ",":
        told["delimiter"] = delimiter
        if any(_DECIMAL_COMMA.fullmatch(cell.strip()) for row in rows[1:] for cell in row):
            told["decimal"] = ","
    return told


def guess_columns(names: Sequence[str]) -> dict[str, Any]:
    """Columns and fiducials by names, and the unit of the positions if a name states it."""
    columns: dict[str, Any] = {key: name for key, words in _NAMES.items() for name in names if _bare(name) in words}
    by_name = {_bare(name): name for name in names}
    wrench = next((group for group in _WRENCH if set(group) <= set(by_name)), ())
    told: dict[str, Any] = {"columns": columns, "fiducials": {}}
    if wrench:
        columns["wrench"] = [by_name[name] for name in wrench]
    if set(_ROTATION) <= set(by_name):
        told["rotation"] = [by_name[name] for name in _ROTATION]
    triples = _triples(names)
    alone = triples.pop("", None)
    if alone is not None and "fiducial" in columns and "step" in columns:
        columns["position"] = alone
        triples = {}
    else:
        columns.pop("fiducial", None)
        # In a row for each frame these may be words.
        if _bare(columns.get("step", "")) in ("state", "stage"):
            del columns["step"]
        if alone is not None:
            triples["marker"] = alone
    if "grasp" not in names:
        columns.pop("grasp", None)
    told["fiducials"] = triples
    used = [name for triple in [*triples.values(), alone or []] for name in triple]
    unit = {match["unit"] for name in used if (match := _stated(name)) and match["unit"]}
    return told | ({"length_unit": unit.pop()} if len(unit) == 1 else {})


def _stated(name: str) -> re.Match[str] | None:
    """The unit at the end of a column's name."""
    return _UNIT.search(name) or _UNIT_BEHIND.search(name.strip())


def _plain(name: str) -> str:
    """A column's name without its unit."""
    return _UNIT_BEHIND.sub("", _UNIT.sub("", name).strip()).strip()


def _bare(name: str) -> str:
    return _plain(name).lower()


def _triples(names: Sequence[str]) -> dict[str, list[str]]:
    """Columns of the three axes by the name that they share; "" for x, y, z alone."""
    found: dict[str, dict[str, str]] = {}
    for column in names:
        bare = _plain(column)
        match = _BEHIND.fullmatch(bare) or _BEFORE.fullmatch(bare)
        if match and (match["name"] or "").lower() not in _NO_MARKERS:
            found.setdefault(match["name"] or "", {})[match["axis"].lower()] = column
    return {name: [axes[a] for a in "xyz"] for name, axes in found.items() if set(axes) == set("xyz")}


def guess_arrays(path: Path) -> dict[str, Any]:
    """Keys of a mapping for a MAT, HDF5 or NPZ file.

    Raises:
        InputError: it is damaged, or nothing in it looks like positions; says what is in it.
    """
    content = look(path, list(_NCORR_GRID))
    field, missing = _of_displacements(content)
    tracked = any(len(s) == 3 and 3 in s and _called(p, _POSITIONS) for p, s in content.shapes.items())
    others = not missing or tracked
    if told := _ncorr(content) or field or (others and (_of_positions(content) or _of_table(content))):
        return told
    if missing:
        raise InputError(f"{path}: {missing}; add it to the file, or write a mapping with [arrays] (docs/formats.md)")
    held = ", ".join(f"{p} ({shown(s)})" for p, s in list(content.shapes.items())[:40]) or "nothing"
    raise InputError(
        f"{path}: no array looks like positions over frames, markers and three axes; it holds {held}: "
        'write a mapping with [arrays], as positions = "PATH", or with table = "PATH"'
    )


def _ncorr(content: ArrayFile) -> dict[str, Any]:
    paths = [_NCORR.format(axis) for axis in "uv"]
    if not set(paths) <= set(content.shapes):
        return {}
    scale, spacing = (float(np.ravel(content.arrays.get(key, 1.0))[0]) for key in _NCORR_GRID)
    order = "frame marker" if len(content.shapes[paths[0]]) == 3 else "marker"
    return {"arrays": {"displacements": paths, "grid": scale * (spacing + 1), "order": order}}


def _of_positions(content: ArrayFile) -> dict[str, Any]:
    fit = [p for p, s in content.shapes.items() if len(s) == 3 and 3 in s and p not in content.text]
    if not fit:
        return {}
    best = max(fit, key=lambda p: (_called(p, _POSITIONS), not _called(p, _OTHERS), int(np.prod(content.shapes[p]))))
    shape = content.shapes[best]
    clocks = {max(s): p for p, s in content.shapes.items() if _vector(s) and p.rpartition("/")[2].lower() in _TIMES}
    order = _order(shape, clocks, stacked="Points3D" in best)
    frames, markers = shape[order.index("frame")], shape[order.index("marker")]
    arrays = {"positions": best, "order": " ".join(order)}
    named = next((p for p in content.text if int(np.prod(content.shapes[p])) == markers), None)
    if named is not None:
        arrays["names"] = named
    columns = {"time": clocks[frames]} if frames in clocks else {}
    for key, width, words in (("pose", 7, ("pose",)), ("wrench", 6, ("wrench", "force", "ft"))):
        fit = [p for p, s in content.shapes.items() if sorted(s) == sorted((frames, width)) and _called(p, words)]
        if fit:
            columns[key] = fit[0]
    return {"arrays": arrays, "columns": columns}


def _order(shape: Shape, clocks: dict[int, str], stacked: bool) -> list[str]:
    """Names of the dimensions: the axis has three, the frames as many as there are times, else more than there are markers."""
    axis = max(i for i, n in enumerate(shape) if n == 3)
    left = [i for i in range(3) if i != axis]
    timed = [i for i in left if shape[i] in clocks]
    frame = timed[0] if timed else left[0] if stacked else max(left, key=lambda i: shape[i])
    return ["axis" if i == axis else "frame" if i == frame else "marker" for i in range(3)]


def _of_table(content: ArrayFile) -> dict[str, Any]:
    """A group of vectors whose names are those of coordinates."""
    groups: dict[str, list[str]] = {}
    for path, shape in content.shapes.items():
        if "/" in path and _vector(shape):
            groups.setdefault(path.rpartition("/")[0], []).append(path.rpartition("/")[2])
    for where, names in groups.items():
        told = guess_columns(names)
        if told["fiducials"] or "position" in told["columns"]:
            return told | {"table": where}
    return {}


def _vector(shape: Shape) -> bool:
    return bool(shape) and int(np.prod(shape)) == max(shape) and max(shape) > 1


def _called(path: str, words: Iterable[str]) -> bool:
    return any(word in f"/{path}".lower() for word in words)


def _of_displacements(content: ArrayFile) -> tuple[dict[str, Any], str]:
    """Keys for displacements and rest positions, or why there are none, in words; both empty where nothing looks like those."""
    moved, missing = _components(content, _MOVED, _MOVED_ALL)
    if not moved:
        return {}, missing
    rest, _ = _components(content, _REST, _REST_ALL, beside=moved)
    if not rest:
        names = ", ".join(moved)
        return {}, f"it has displacements ({names}), but no positions at rest of the same points, as x, y, z"
    if len(moved) > 1 and len(rest) > len(moved):
        # A plane field has two of both.
        return {}, f"it has rest positions {', '.join(rest)}, but displacements {', '.join(moved)} alone"
    shape = _shape(content, moved[0])
    order = _order_of_field(shape, [_shape(content, one) for one in rest], alone=len(moved) == 1)
    if order is None:
        text = "displacements {} are {}, and rest positions {} are {}: they are not of the same points"
        return {}, text.format(moved[0], shown(shape), rest[0], shown(_shape(content, rest[0])))
    arrays: dict[str, Any] = {"displacements": moved if len(moved) > 1 else moved[0]}
    arrays |= {"rest": rest if len(rest) > 1 else rest[0], "order": " ".join(order)}
    spread = zip(shape, _spread(order, shape), strict=True)
    field = shape if len(moved) > 1 else tuple(n for n, dimension in spread if dimension != "axis")
    for path in _steps(content):
        if _last(path) in _QUALITY and _shape(content, path) == field:
            arrays["quality"] = path
    frames = {shape[0 if order[0] == "frame" else -1]} if "frame" in order else set()
    clock = [p for p, s in content.shapes.items() if _last(p) in _TIMES and {int(np.prod(s))} == frames]
    return {"arrays": arrays, "columns": {"time": clock[0]} if clock else {}}, ""


def _last(path: str) -> str:
    return path.rpartition("/")[2].lower()


def _steps(content: ArrayFile) -> Iterator[str]:
    """Paths; those that are the same but for a number in a group, as step_01/u, as one with * in its place."""
    patterns: dict[str, list[str]] = {}
    for path in content.shapes:
        if path not in content.text:
            group, slash, name = path.rpartition("/")
            patterns.setdefault(re.sub(r"\d+", "*", group) + slash + name, []).append(path)
    for pattern, paths in patterns.items():
        several = len(paths) > 1 and len({content.shapes[p] for p in paths}) == 1
        yield from [pattern] if several else paths


def _shape(content: ArrayFile, path: str) -> Shape:
    """Of an array in each step where a path has *."""
    if "*" not in path:
        return content.shapes[path]
    group, _, name = path.rpartition("/")
    fits = re.compile(re.escape(group).replace(r"\*", r"\d+") + "/" + re.escape(name))
    return next(shape for one, shape in content.shapes.items() if fits.fullmatch(one))


def _components(
    content: ArrayFile, triples: Sequence[str], alone: Sequence[str], beside: Sequence[str] = ()
) -> tuple[list[str], str]:
    """Paths of two or three arrays with names of components, in one group, or of one array of all; else what is missing."""
    groups: dict[str, dict[str, str]] = {}
    missing = ""
    for path in _steps(content):
        if path not in beside:
            groups.setdefault(path.rpartition("/")[0], {})[_last(path)] = path
    # Rest positions may stand in another group than the displacements.
    for triple in map(str.split, triples):
        for names in groups.values():
            there = [names[name] for name in triple if name in names]
            alike = len({_shape(content, one) for one in there}) == 1 or bool(beside)
            if len(there) == 3 and alike:
                return there, ""
            if alike and not beside and triple[:2] == [*map(_last, there)]:
                if not any({"z", "z0", "pos_z", "grid_z"} & set(other) for other in groups.values()):
                    return there, ""
                missing = (
                    f"it has the displacements {there[0]} and {there[1]}, but no {triple[2]}, and its points have a z"
                )
            if len(there) == 2 and len(beside) == 2:
                return there, ""
    if missing:
        return [], missing
    for name in alone:
        for names in groups.values():
            if name in names and 3 in _shape(content, names[name]):
                return [names[name]], ""
    return [], missing


def _order_of_field(shape: Shape, rest: list[Shape], alone: bool) -> list[str] | None:
    """Names of the dimensions of displacements, by the shapes of their rest positions; None where they do not fit."""
    axis = ["marker", "axis"] if alone else ["marker"]
    if alone and len(rest) > 1:
        return None
    fits = {rest[0]} | ({_squeezed(rest[0])} if not alone else set())
    if len(rest) > 1 and all(int(np.prod(one)) == max(one, default=0) for one in rest):
        lengths = tuple(max(one) for one in rest)
        fits |= {lengths, (lengths[1], lengths[0], *lengths[2:])}
    if alone and (len(rest[0]) < 2 or rest[0][-1] != 3):
        return None
    if shape in fits or (not alone and _squeezed(shape) in fits):
        return axis
    if shape[1:] in fits:
        return ["frame", *axis]
    return [*axis, "frame"] if shape[:-1] in fits else None


def _squeezed(shape: Shape) -> Shape:
    """Without dimensions of one, which MATLAB adds to vectors."""
    return tuple(n for n in shape if n != 1)


def _spread(order: Sequence[str], shape: Shape) -> list[str]:
    """The name of each dimension, where several may be those of the markers."""
    more = len(shape) - len(order) + 1
    return [one for name in order for one in [name] * (more if name == "marker" else 1)]
