"""The mapping file (TOML): it says which columns of a table, or which points of a recording, are what.

docs/measurement.md and docs/formats.md describe the format, with an example of each kind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems
from bcid.base.text_file import read_toml
from bcid.base.units import FURTHEST, quantity
from bcid.measurement.contents import SIGMAS, Sigma, Units
from bcid.measurement.formats.array_file import DIMENSIONS
from bcid.measurement.formats.foreign import CORRELATION
from bcid.measurement.formats.recognise import DIC, TABLE, Format, files, recognise
from bcid.measurement.stated import UNITS, Stated, are_texts, is_number

FORMAT = "bcid-mapping/1"
_TEXTS = ("grasp", "action", "description", "delimiter", "table", "grasps")
COLUMNS = ("action", "step", "time", "fiducial", "position", "grasp", "translation", "rotation", "pose", "wrench")
# How many columns of a table make a vector; of some a part may be missing: what was not measured has an empty name.
_VECTORS = {"position": 3, "translation": 3, "rotation": 4, "pose": 7, "wrench": 6}
_PARTIAL = ("position", "wrench")
# The frame of rest is the state from which displacements count, which is no frame of the file.
REFERENCE = "reference"
# The quality that each bound of [points] is for, and whether it is a least one.
BOUNDS = {"least_score": ("score", True), "most_error": ("error", False), "least_cameras": ("cameras", True)}
BOUNDS["least_correlation"] = (CORRELATION, True)
# Tables within a mapping, and their keys where these are not names of markers.
_TABLES: dict[str, tuple[str, ...]] = {
    "columns": (*COLUMNS, "rest", "displacement", "point", "quality"),
    "frames": ("first", "last", "every", "rest"),
    "points": ("every", *BOUNDS),
    "arrays": ("positions", "displacements", "rest", "grid", "order", "names", "quality"),
    "pixels": ("length", "uncertainty"),
    "force": ("file", "wrench", "time", "way", "offset"),
}
_MARKERS = ("fiducials", "reference", "gripper", "align")
_KEYS = ("format", "file", *UNITS, *SIGMAS, *_TEXTS, "decimal", "rate", "grasp_centre", *_TABLES, *_MARKERS)

Array = NDArray[np.float64]


@dataclass
class Mapping:
    """The validated content of a mapping file; length, time and force are the units, SI, and so is the length of a pixel.

    Attributes:
        files: of the recording; `format`: theirs, and `labelled`: whether markers are named by labels in them.
        table: everything that is stated.
        markers: columns or label of each marker; those of `fiducials` are measured, the others help to align or are on the gripper.
        frames: first, last, every how many, and the frame of rest, counted from the state of reference where that is the first.
        from_reference: whether the frame of rest is the state from which displacements count.
        align: places of markers in the frame of the body, in the unit of length.
        sigmas: standard deviations of positions, forces and torques, SI.
    """

    path: Path
    files: list[Path]
    format: Format
    labelled: bool
    units: Units
    length: float
    time: float
    force: float
    table: dict[str, Any]
    columns: dict[str, Any]
    markers: dict[str, Any]
    fiducials: list[str]
    frames: tuple[int, int | None, int, int | None]
    from_reference: bool
    align: dict[str, Array]
    sigmas: tuple[Sigma, float | None, float | None]
    pixel: float | None = None

    @property
    def file(self) -> Path:
        """The recording, or the first of its files."""
        return self.files[0]


def read_mapping(path: Path) -> Mapping:
    """A mapping file, checked.

    Raises:
        InputError: with every problem of it.
    """
    stated = read_toml(path)
    check = Stated(path, problems := Problems(f"mapping {path}"))
    check.expect(stated.get("format") == FORMAT, "format", f'"{FORMAT}"', stated.get("format"))
    check.only(stated, _KEYS)
    table = stated | {key: check.table(stated, key) for key in (*_TABLES, *_MARKERS)}
    for key, allowed in _TABLES.items():
        replace(check, prefix=f"{key}.").only(table[key], allowed)
    units, (length, time, force) = check.units(table)
    sigmas = check.sigmas(table, length, force)
    found, form = _recording(check, table.get("file"), table["columns"])
    for key in _TEXTS:
        check.expect(isinstance(table.get(key, ""), str), key, "text", table.get(key))
    check.expect(len(str(table.get("delimiter", ","))) == 1, "delimiter", "one character", table.get("delimiter"))
    check.expect(table.get("decimal", ".") in (".", ","), "decimal", '"." or ","', table.get("decimal"))
    rate = table.get("rate", 1)
    check.expect(is_number(rate) and rate > 0, "rate", "a positive number up to 1e30", rate)
    labelled = _labelled(form, table)
    if labelled:
        _check_labelled(check, form, table)
    _check_markers(check, table, length, labelled)
    _check_gripper(check, table, length)
    pixel = _pixel(replace(check, prefix="pixels."), table["pixels"]) if "pixels" in stated else None
    if table["force"]:
        _check_force(check, table, labelled or "time" in table["columns"] or "rate" in table)
    frames = _frames(replace(check, prefix="frames."), table["frames"], labelled)
    problems.raise_if_any()
    markers = table["fiducials"] | table["reference"] | table["gripper"]
    if labelled:
        markers = {name: str(label) for name, label in markers.items()}
    align = {name: np.array(place, dtype=float) for name, place in table["align"].items()}
    rests = table["frames"].get("rest") == REFERENCE
    file = found, form, labelled, units, length, time, force
    return Mapping(
        path, *file, table, table["columns"], markers, list(table["fiducials"]), frames, rests, align, sigmas, pixel
    )


def _recording(check: Stated, file: object, columns: dict[str, Any]) -> tuple[list[Path], Format]:
    """The files that a mapping names, and their format."""
    found = files(check.path.parent, file) if isinstance(file, str) and file else []
    if not check.expect(bool(found), "file", "the name of a table or C3D file beside the mapping", file):
        return [check.path], TABLE
    try:
        known = DIC if "displacement" in columns else recognise(found[0])
    except InputError as error:
        check.bad("file", str(error))
        return found, TABLE
    if len(found) > 1 and not (known.series or known.arrays):
        what = "only image or volume correlation has one a frame"
        check.bad("file", f"'{file}' are {len(found)} files, each a {known.words}; {what}")
    return found, known


def _labelled(form: Format, table: dict[str, Any]) -> bool:
    """Whether markers are named by labels of the file, and not by columns of a table."""
    if form is TABLE or "table" in table or "fiducial" in table["columns"]:
        return False
    # Their header is a single line, whose columns may be named as those of any table.
    single = form.name in ("anipose", "dic")
    return not (single and any(isinstance(marker, list) for marker in table["fiducials"].values()))


def _check_labelled(check: Stated, form: Format, table: dict[str, Any]) -> None:
    """Note what is wrong in the keys of a mapping that are for files with labels."""
    points, columns = table["points"], table["columns"]
    every = points.get("every", 1)
    check.expect(type(every) is int and every >= 1, "points.every", "a whole number of at least 1", every)
    for key in BOUNDS:
        check.expect(type(points.get(key, 0)) in (int, float), f"points.{key}", "a number", points.get(key))
    for key in ("action", "step", "fiducial", "position", "grasp", "translation", "rotation"):
        if key in columns and form.name != "c3d" and not (form.series and key == "step"):
            check.bad(f"columns.{key}", f"is for tables with a header line; a {form.words} names its markers itself")
    what = "one path of an array" if form.arrays else "one label in the file"
    for key in ("time", "pose", "wrench"):
        check.expect(_named(columns.get(key, "x")), f"columns.{key}", what, columns.get(key))
    if form.series:
        for key in ("rest", "displacement"):
            fine = key not in columns or are_texts(columns[key], 3)
            check.expect(fine, f"columns.{key}", "the names of 3 columns", columns.get(key))
        if ("rest" in columns) != ("displacement" in columns):
            check.bad("columns.rest and columns.displacement", "give both or neither")
        for key in ("point", "quality"):
            fine = isinstance(columns.get(key, "x"), str)
            check.expect(fine, f"columns.{key}", "the name of a column", columns.get(key))
    if form.arrays:
        _check_arrays(replace(check, prefix="arrays"), table["arrays"])
    elif table["arrays"]:
        check.bad("arrays", f"is for MAT, HDF5 and NPZ files; this is a {form.words}")


def _check_arrays(check: Stated, arrays: dict[str, Any]) -> None:
    if ("positions" in arrays) == ("displacements" in arrays):
        advice = 'as positions = "tracks/xyz"; `bcid import FILE` lists what is in it'
        check.bad("", f"name either the array of positions or that of displacements, {advice}")
    for key in ("positions", "displacements", "rest"):
        value = arrays.get(key, "x")
        fine = _named(value) or are_texts(value, 2) or are_texts(value, 3)
        check.expect(fine, f".{key}", "a path, or one for each axis", value)
    if "displacements" in arrays and ("rest" in arrays) == ("grid" in arrays):
        check.bad(".displacements", "needs arrays.rest, the rest positions, or arrays.grid, their spacing")
    grid = arrays.get("grid", 1)
    fine = type(grid) in (int, float) and 0 < grid < 1e6
    check.expect(fine, ".grid", "a positive number in length_unit", grid)
    order = str(arrays.get("order", " ".join(DIMENSIONS))).split()
    fine = {"marker"} <= set(order) <= set(DIMENSIONS) and len(set(order)) == len(order)
    if not check.expect(fine, ".order", f'the words of "{" ".join(DIMENSIONS)}" in any order', arrays.get("order")):
        return
    if isinstance(arrays.get("positions", arrays.get("displacements")), str) and "axis" not in order:
        check.bad(".order", "one array of all three axes has the dimension axis")
    for key in ("names", "quality"):
        check.expect(isinstance(arrays.get(key, ""), str), f".{key}", "a path", arrays.get(key))


def _pixel(check: Stated, table: dict[str, Any]) -> float:
    """Length of a pixel, m, where positions are in pixels."""
    check.scale(table, "uncertainty")
    try:
        if "length" not in table:
            raise InputError('is missing; write the length of a pixel where the body is, as length = "0.05 mm"')
        length = quantity(table["length"], "m")
        if not length > 0:
            raise InputError(f"{table['length']!r} must be positive")
        return length
    except InputError as error:
        check.bad("length", str(error))
    return 1.0


def _check_markers(check: Stated, table: dict[str, Any], length: float, labelled: bool) -> None:
    columns, named, align = table["columns"], table["fiducials"] | table["reference"], table["align"]
    long = "fiducial" in columns
    if not table["fiducials"] and not long and not labelled:
        check.bad("fiducials", "name at least one, or give columns.fiducial and columns.position")
    for name, marker in (named | table["gripper"]).items():
        if labelled or long:
            fine = isinstance(marker, str) or (labelled and type(marker) is int)
            check.expect(fine, f"fiducials.{name}", "the label of a marker", marker)
        else:
            text = 'three columns, as ["x", "y", "z"], or ["x", "y", ""] where z was not measured'
            check.expect(are_texts(marker, 3, partial=True), f"fiducials.{name}", text, marker)
    for key, count in () if labelled else _VECTORS.items():
        if key in columns:
            gaps = ', "" for one that was not measured' if key in _PARTIAL else ""
            fine = are_texts(columns[key], count, key in _PARTIAL)
            check.expect(fine, f"columns.{key}", f"the names of {count} columns{gaps}", columns[key])
    for key in ("action", "step", "time", "fiducial", "grasp"):
        check.expect(_named(columns.get(key, key)), f"columns.{key}", "the name of a column", columns.get(key))
    for name, place in align.items():
        _check_place(check, f"align.{name}", place, length)
        if not long and (table["fiducials"] or not labelled) and name not in named:
            check.bad(f"align.{name}", "is neither in fiducials nor in reference")
    if 0 < len(align) < 3:
        check.bad("align", "at least three markers, not on a line, fix a frame")


def _check_gripper(check: Stated, table: dict[str, Any], length: float) -> None:
    """What concerns absolute poses of the gripper, and markers on it."""
    columns, marked = table["columns"], table["gripper"]
    pose, relative = "pose" in columns, {"translation", "rotation"} & set(columns)
    if "grasp_centre" in table:
        _check_place(check, "grasp_centre", table["grasp_centre"], length)
    if pose and relative:
        check.bad("columns.pose", "is the whole pose; leave columns.translation and columns.rotation out")
    if "grasps" in table:
        others = [key for key in ("grasp", "gripper", "grasp_centre") if table.get(key)]
        others += [f"columns.{key}" for key in ("grasp", "translation", "rotation", "pose") if key in columns]
        if others:
            check.bad("grasps", f"is the whole motion of the gripper; leave {', '.join(others)} out")
        if isinstance(table["grasps"], str):
            there = (check.path.parent / table["grasps"]).is_file()
            check.expect(there, "grasps", "the name of a grasps.csv beside the mapping", table["grasps"])
    for what, there in (("columns.pose", pose), ("gripper", bool(marked))):
        if there and "grasp" not in table and "grasp" not in columns:
            check.bad(what, 'whose is it? Name the grasp of the scene, as grasp = "II"')
    if marked:
        if pose or relative:
            check.bad("gripper", "its markers tell its motion; leave columns.translation, rotation and pose out")
        if len(marked) < 3:
            check.bad("gripper", "name at least three markers on it, not on a line")
        if "grasp_centre" not in table:
            check.bad("grasp_centre", "is missing; write where the gripper holds at rest, as the scene has it")


def _check_force(check: Stated, table: dict[str, Any], clocked: bool) -> None:
    """What is wrong with [force]; `clocked`: whether the images have times."""
    force = table["force"]
    name, wrench, offset = force.get("file"), force.get("wrench"), force.get("offset", 0)
    check.expect(_named(name), "force.file", "the name of a table beside the mapping", name)
    fine = are_texts(wrench, _VECTORS["wrench"], partial=True)
    check.expect(fine, "force.wrench", 'six columns, "" for one that was not measured', wrench)
    for key in ("time", "way"):
        check.expect(_named(force.get(key, key)), f"force.{key}", "the name of a column", force.get(key))
    if not {"time", "way"} & set(force):
        check.bad("force", 'name its column of time, or of the way of the gripper, as way = "crosshead"')
    fine = type(offset) in (int, float) and math.isfinite(offset)
    check.expect(fine, "force.offset", "a number in time_unit", offset)
    if "offset" in force and "time" not in force:
        check.bad("force.offset", "is one of clocks; give force.time too")
    if "time" in force and not clocked:
        check.bad("force.time", "the frames of the images have no times; give columns.time or rate")
    if "wrench" in table["columns"]:
        check.bad("force", "stands beside columns.wrench; leave one of them out")


def _named(value: object) -> bool:
    return isinstance(value, str) and bool(value)


def _check_place(check: Stated, key: str, value: object, length: float) -> None:
    fine = isinstance(value, list) and len(value) == 3
    fine = fine and all(type(v) in (int, float) and abs(v) * length <= FURTHEST for v in value)  # type: ignore[attr-defined]
    check.expect(fine, key, "three numbers in length_unit, none beyond 1000 km", value)


def _frames(check: Stated, table: dict[str, Any], labelled: bool) -> tuple[int, int | None, int, int | None]:
    first, last, every, rest = table.get("first", 0), table.get("last"), table.get("every", 1), table.get("rest")
    if rest == REFERENCE:
        rest = None
        if not labelled:
            check.bad("rest", '"reference" is for files of displacements; give the number of a frame')
    for name, value, least in (("first", first, 0), ("last", last, 0), ("every", every, 1), ("rest", rest, 0)):
        fine = value is None or (type(value) is int and value >= least)
        check.expect(fine, name, f"a whole number of at least {least}", value)
    if type(rest) is int and type(first) is int and rest > first:
        check.bad("rest", f"the frame of rest, {rest}, must not come after the first that is used, {first}")
    if table.get("rest") == REFERENCE and type(first) is int:
        return first + 1, last + 1 if type(last) is int else None, every, 0
    return first, last, every, rest
