"""The mapping file (TOML): it says which columns of a table, or which points of a recording, are what.

docs/measurement.md and docs/formats.md describe the format, with an example of each kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems
from bcid.base.text_file import read_toml
from bcid.base.units import FURTHEST, LEAST_SIGMA, measurable, quantity, unit_factor, usable
from bcid.measurement.contents import SIGMAS, Units, sigma_units
from bcid.measurement.force_recording import check_force
from bcid.measurement.formats.recognise import DIC, TABLE, Format, files, recognise
from bcid.measurement.labelled_keys import ARRAYS, POINTS, check_points
from bcid.measurement.scale import checked_scale

FORMAT = "bcid-mapping/1"
_UNITS = {"length_unit": "m", "time_unit": "s", "force_unit": "N"}
_KEYS = ("format", "file", *_UNITS, "noise_sigma", "description", "delimiter", "grasp", "action", "frames", "columns")
_KEYS += (
    "fiducials",
    "reference",
    "gripper",
    "force",
    "align",
    "decimal",
    "rate",
    "table",
    "points",
    "arrays",
    "grasp_centre",
    "wrench_sigma",
    "torque_sigma",
    "pixels",
    "grasps",
)
COLUMNS = ("action", "step", "time", "fiducial", "position", "grasp", "translation", "rotation", "pose", "wrench")
# How many columns of a table make a vector.
_VECTORS = {"position": 3, "translation": 3, "rotation": 4, "pose": 7, "wrench": 6}
# Those of which some columns may be missing: what was not measured has an empty name.
_PARTIAL = ("position", "wrench")
# Columns of image correlation.
_DIC_COLUMNS = ("rest", "displacement", "point", "quality")
_FRAMES = ("first", "last", "every", "rest")
# The frame of rest is the state from which displacements count, which is no frame of the file.
REFERENCE = "reference"

Array = NDArray[np.float64]


@dataclass
class Mapping:
    """The validated content of a mapping file."""

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
    table = read_toml(path)
    problems = Problems(f"mapping {path}")
    if table.get("format") != FORMAT:
        problems.add(path, f'format: expected "{FORMAT}", found {table.get("format")!r}')
    problems.add_unknown(path, table, _KEYS)
    tables = {
        key: _table(path, table, key, problems)
        for key in (
            "columns",
            "fiducials",
            "reference",
            "gripper",
            "force",
            "align",
            "frames",
            "points",
            "arrays",
            "pixels",
        )
    }
    allowed_keys = {"columns": (*COLUMNS, *_DIC_COLUMNS), "frames": _FRAMES, "points": POINTS, "arrays": ARRAYS}
    for key, allowed in allowed_keys.items():
        problems.add_unknown(path, tables[key], allowed, f"{key}.{{}}: unknown key; {{}}".format)
    factors = {key: _factor(path, table, key, like, problems) for key, like in _UNITS.items()}
    recordings, found = _recording(path, table.get("file"), tables["columns"], problems)
    for key in ("grasp", "action", "description", "delimiter", "table", "grasps"):
        if not isinstance(table.get(key, ""), str):
            problems.add(path, f"{key}: expected text, found {table[key]!r}")
    if len(str(table.get("delimiter", ","))) != 1:
        problems.add(path, f"delimiter: expected one character, found {table.get('delimiter')!r}")
    if table.get("decimal", ".") not in (".", ","):
        problems.add(path, f'decimal: expected "." or ",", found {table["decimal"]!r}')
    _positive(path, "rate", table.get("rate"), problems)
    for key, unit in zip(SIGMAS, sigma_units(factors["length_unit"], factors["force_unit"]), strict=True):
        _check_sigma(path, key, table.get(key), unit, problems)
    labelled = _labelled(found, table, tables)
    if labelled:
        check_points(path, found, tables, problems)
    _check_markers(path, tables, factors["length_unit"], labelled, problems)
    _check_gripper(path, table, factors["length_unit"], problems)
    pixel = _pixel(path, tables["pixels"], problems) if "pixels" in table else None
    if tables["force"]:
        clocked = labelled or "time" in tables["columns"] or "rate" in table
        check_force(path, tables["force"], tables["columns"], clocked, problems)
    frames = _frames(path, tables["frames"], labelled, problems)
    problems.raise_if_any()
    units = Units(*(str(table[key]) for key in _UNITS))
    align = {name: np.array(place, dtype=float) for name, place in tables["align"].items()}
    markers = tables["fiducials"] | tables["reference"] | tables["gripper"]
    if labelled:
        markers = {name: str(label) for name, label in markers.items()}
    names = list(tables["fiducials"])
    length, time, force = (factors[key] for key in _UNITS)
    told = table | tables
    return Mapping(
        path,
        recordings,
        found,
        labelled,
        units,
        length,
        time,
        force,
        told,
        tables["columns"],
        markers,
        names,
        frames,
        tables["frames"].get("rest") == REFERENCE,
        align,
        pixel,
    )


def _recording(path: Path, file: object, columns: dict[str, Any], problems: Problems) -> tuple[list[Path], Format]:
    """The files that a mapping names, and their format."""
    found = files(path.parent, file) if isinstance(file, str) and file else []
    if not found:
        problems.add(path, f"file: expected the name of a table or C3D file beside the mapping, found {file!r}")
        return [path], TABLE
    try:
        known = DIC if "displacement" in columns else recognise(found[0])
    except InputError as error:
        problems.add(path, f"file: {error}")
        return found, TABLE
    if len(found) > 1 and not (known.series or known.arrays):
        what = "only image or volume correlation has one a frame"
        problems.add(path, f"file: '{file}' are {len(found)} files, each a {known.words}; {what}")
    return found, known


def _labelled(found: Format, table: dict[str, Any], tables: dict[str, dict[str, Any]]) -> bool:
    """Whether markers are named by labels of the file, and not by columns of a table."""
    if found is TABLE or "table" in table or "fiducial" in tables["columns"]:
        return False
    # Their header is a single line, whose columns may be named as those of any table.
    single = found.name in ("anipose", "dic")
    return not (single and any(isinstance(marker, list) for marker in tables["fiducials"].values()))


def _positive(path: Path, key: str, value: object, problems: Problems) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool) and usable(value) and value > 0
    if value is not None and not number:
        problems.add(path, f"{key}: expected a positive number up to 1e30, found {value!r}")


def _pixel(path: Path, table: dict[str, Any], problems: Problems) -> float:
    """Length of a pixel, m, where positions are in pixels."""
    problems.add_unknown(path, table, ("length", "uncertainty"), "pixels.{}: unknown key; {}".format)
    checked_scale(path, table, problems, "pixels.uncertainty")
    try:
        if "length" not in table:
            raise InputError('is missing; write the length of a pixel where the body is, as length = "0.05 mm"')
        length = quantity(table["length"], "m")
        if not length > 0:
            raise InputError(f"{table['length']!r} must be positive")
        return length
    except InputError as error:
        problems.add(path, f"pixels.length: {error}")
    return 1.0


def _check_sigma(path: Path, key: str, stated: object, unit: float, problems: Problems) -> None:
    """A standard deviation, or of positions that of each axis."""
    each = stated if key == "noise_sigma" and isinstance(stated, list) else [stated]
    if each is stated and len(each) != 3:
        problems.add(path, f"{key}: expected one number, or three for x, y and z, found {stated!r}")
    for value in each:
        _positive(path, key, value, problems)
        if isinstance(value, int | float) and value > 0 and not measurable(value * unit):
            problems.add(path, f"{key}: {value!r} is no noise; at least {LEAST_SIGMA / unit:.3g} is expected")


def _check_gripper(path: Path, table: dict[str, Any], length: float, problems: Problems) -> None:
    """What concerns absolute poses of the gripper, and markers on it."""
    columns = _table(path, table, "columns", Problems(""))
    centre, given = table.get("grasp_centre"), "pose" in columns
    if centre is not None and not _three_numbers(centre, length):
        problems.add(
            path, f"grasp_centre: expected three numbers in length_unit, none beyond 1000 km, found {centre!r}"
        )
    if given and ("translation" in columns or "rotation" in columns):
        problems.add(path, "columns.pose: is the whole pose; leave columns.translation and columns.rotation out")
    marked = table.get("gripper")
    if "grasps" in table:
        others: list[str] = [key for key in ("grasp", "gripper", "grasp_centre") if key in table]
        others += [f"columns.{key}" for key in ("grasp", "translation", "rotation", "pose") if key in columns]
        if others:
            problems.add(path, f"grasps: is the whole motion of the gripper; leave {', '.join(others)} out")
        if isinstance(table["grasps"], str) and not (path.parent / table["grasps"]).is_file():
            problems.add(
                path, f"grasps: expected the name of a grasps.csv beside the mapping, found '{table['grasps']}'"
            )
    for what, there in (("columns.pose", given), ("gripper", bool(marked))):
        if there and "grasp" not in table and "grasp" not in columns:
            problems.add(path, f'{what}: whose is it? Name the grasp of the scene, as grasp = "II"')
    if isinstance(marked, dict) and marked:
        if {"translation", "rotation", "pose"} & set(columns):
            problems.add(path, "gripper: its markers tell its motion; leave columns.translation, rotation and pose out")
        if len(marked) < 3:
            problems.add(path, "gripper: name at least three markers on it, not on a line")
        if centre is None:
            problems.add(path, "grasp_centre: is missing; write where the gripper holds at rest, as the scene has it")


def _table(path: Path, table: dict[str, Any], key: str, problems: Problems) -> dict[str, Any]:
    value = table.get(key, {})
    if isinstance(value, dict):
        return value
    problems.add(path, f"{key}: expected a table, found {value!r}")
    return {}


def _factor(path: Path, table: dict[str, Any], key: str, like: str, problems: Problems) -> float:
    try:
        if not isinstance(table.get(key), str):
            raise InputError(f'is missing; write {key} = "{"mm" if like == "m" else like}"')
        return unit_factor(table[key], like)
    except InputError as error:
        problems.add(path, f"{key}: {error}")
        return 1.0


def _check_markers(
    path: Path, tables: dict[str, dict[str, Any]], length: float, labelled: bool, problems: Problems
) -> None:
    long = "fiducial" in tables["columns"]
    if not tables["fiducials"] and not long and not labelled:
        problems.add(path, "fiducials: name at least one, or give columns.fiducial and columns.position")
    for name, columns in (tables["fiducials"] | tables["reference"] | tables["gripper"]).items():
        if labelled or long:
            if not isinstance(columns, str) and not (labelled and type(columns) is int):
                problems.add(path, f"fiducials.{name}: expected the label of a marker, found {columns!r}")
        elif not _texts(columns, 3, partial=True):
            text = 'expected three columns, as ["x", "y", "z"], or ["x", "y", ""] where z was not measured'
            problems.add(path, f"fiducials.{name}: {text}, found {columns!r}")
    for key, count in () if labelled else _VECTORS.items():
        if key in tables["columns"] and not _texts(tables["columns"][key], count, key in _PARTIAL):
            gaps = ', "" for one that was not measured' if key in _PARTIAL else ""
            problems.add(
                path, f"columns.{key}: expected the names of {count} columns{gaps}, found {tables['columns'][key]!r}"
            )
    for key in ("action", "step", "time", "fiducial", "grasp"):
        name = tables["columns"].get(key, key)
        if not isinstance(name, str) or not name:
            problems.add(path, f"columns.{key}: expected the name of a column, found {name!r}")
    for name, place in tables["align"].items():
        if not _three_numbers(place, length):
            problems.add(
                path, f"align.{name}: expected three numbers in length_unit, none beyond 1000 km, found {place!r}"
            )
        if not long and (tables["fiducials"] or not labelled) and name not in tables["fiducials"] | tables["reference"]:
            problems.add(path, f"align.{name}: is neither in fiducials nor in reference")
    if 0 < len(tables["align"]) < 3:
        problems.add(path, "align: at least three markers, not on a line, fix a frame")


def _three_numbers(value: object, length: float) -> bool:
    if not isinstance(value, list) or len(value) != 3:
        return False
    return all(type(v) in (int, float) and abs(v) * length <= FURTHEST for v in value)


def _texts(value: object, count: int, partial: bool = False) -> bool:
    """Whether it is a list of so many names, some of which may be empty where it may be partial."""
    if not (isinstance(value, list) and len(value) == count and all(isinstance(v, str) for v in value)):
        return False
    return any(value) if partial else all(value)


def _frames(
    path: Path, table: dict[str, Any], labelled: bool, problems: Problems
) -> tuple[int, int | None, int, int | None]:
    first, last, every, rest = table.get("first", 0), table.get("last"), table.get("every", 1), table.get("rest")
    rest = None if rest == REFERENCE else rest
    for name, value, least in (("first", first, 0), ("last", last, 0), ("every", every, 1), ("rest", rest, 0)):
        if value is not None and (type(value) is not int or value < least):
            problems.add(path, f"frames.{name}: expected a whole number of at least {least}, found {value!r}")
    if table.get("rest") == REFERENCE and not labelled:
        problems.add(path, 'frames.rest: "reference" is for files of displacements; give the number of a frame')
    if type(rest) is int and type(first) is int and rest > first:
        problems.add(
            path, f"frames.rest: the frame of rest, {rest}, must not come after the first that is used, {first}"
        )
    return first, last, every, rest
