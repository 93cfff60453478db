"""The mapping file (TOML): it says which columns of a table, or which points of a recording, are what.

docs/measurement.md describes the format, with an example of each kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems
from bcid.base.text_file import read_toml
from bcid.base.units import FURTHEST, unit_factor, usable
from bcid.measurement.contents import Units

FORMAT = "bcid-mapping/1"
_UNITS = {"length_unit": "m", "time_unit": "s", "force_unit": "N"}
_KEYS = ("format", "file", *_UNITS, "noise_sigma", "description", "delimiter", "grasp", "action", "frames", "columns")
_KEYS += ("fiducials", "reference", "align")
COLUMNS = ("action", "step", "time", "fiducial", "position", "grasp", "translation", "rotation")
_FRAMES = ("first", "last", "every")

Array = NDArray[np.float64]


@dataclass
class Mapping:
    """The validated content of a mapping file."""

    path: Path
    file: Path
    units: Units
    length: float
    time: float
    table: dict[str, Any]
    columns: dict[str, Any]
    markers: dict[str, Any]
    fiducials: list[str]
    frames: tuple[int, int | None, int]
    align: dict[str, Array]


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
        key: _table(path, table, key, problems) for key in ("columns", "fiducials", "reference", "align", "frames")
    }
    for key, allowed in (("columns", COLUMNS), ("frames", _FRAMES)):
        problems.add_unknown(path, tables[key], allowed, f"{key}.{{}}: unknown key; {{}}".format)
    factors = {key: _factor(path, table, key, like, problems) for key, like in _UNITS.items()}
    file = table.get("file")
    if not isinstance(file, str) or not (path.parent / file).is_file():
        problems.add(path, f"file: expected the name of a table or C3D file beside the mapping, found {file!r}")
    for key in ("grasp", "action", "description", "delimiter"):
        if not isinstance(table.get(key, ""), str):
            problems.add(path, f"{key}: expected text, found {table[key]!r}")
    if len(str(table.get("delimiter", ","))) != 1:
        problems.add(path, f"delimiter: expected one character, found {table.get('delimiter')!r}")
    sigma = table.get("noise_sigma")
    if sigma is not None and (
        isinstance(sigma, bool) or not isinstance(sigma, int | float) or not usable(sigma) or sigma <= 0
    ):
        problems.add(path, f"noise_sigma: expected a positive number up to 1e30, found {sigma!r}")
    _check_markers(path, tables, factors["length_unit"], str(file).lower().endswith(".c3d"), problems)
    frames = _frames(path, tables["frames"], problems)
    problems.raise_if_any()
    units = Units(*(str(table[key]) for key in _UNITS))
    align = {name: np.array(place, dtype=float) for name, place in tables["align"].items()}
    markers = tables["fiducials"] | tables["reference"]
    names = list(tables["fiducials"])
    factor = factors["length_unit"], factors["time_unit"]
    return Mapping(
        path, path.parent / str(file), units, *factor, table, tables["columns"], markers, names, frames, align
    )


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


def _check_markers(path: Path, tables: dict[str, dict[str, Any]], length: float, c3d: bool, problems: Problems) -> None:
    long = "fiducial" in tables["columns"]
    if not tables["fiducials"] and not long:
        problems.add(path, "fiducials: name at least one, or give columns.fiducial and columns.position")
    for name, columns in (tables["fiducials"] | tables["reference"]).items():
        if c3d or long:
            if not isinstance(columns, str):
                problems.add(path, f"fiducials.{name}: expected the label of a marker, found {columns!r}")
        elif not _texts(columns, 3):
            problems.add(path, f'fiducials.{name}: expected three columns, as ["x", "y", "z"], found {columns!r}')
    for key, count in (("position", 3), ("translation", 3), ("rotation", 4)):
        if key in tables["columns"] and not _texts(tables["columns"][key], count):
            problems.add(
                path, f"columns.{key}: expected the names of {count} columns, found {tables['columns'][key]!r}"
            )
    for key in ("action", "step", "time", "fiducial", "grasp"):
        name = tables["columns"].get(key, key)
        if not isinstance(name, str) or not name:
            problems.add(path, f"columns.{key}: expected the name of a column, found {name!r}")
    for name, place in tables["align"].items():
        numbers = (
            isinstance(place, list)
            and len(place) == 3
            and all(type(v) in (int, float) and abs(v) * length <= FURTHEST for v in place)
        )
        if not numbers:
            problems.add(
                path, f"align.{name}: expected three numbers in length_unit, none beyond 1000 km, found {place!r}"
            )
        if not long and name not in tables["fiducials"] | tables["reference"]:
            problems.add(path, f"align.{name}: is neither in fiducials nor in reference")
    if 0 < len(tables["align"]) < 3:
        problems.add(path, "align: at least three markers, not on a line, fix a frame")


def _texts(value: object, count: int) -> bool:
    return isinstance(value, list) and len(value) == count and all(isinstance(v, str) and v for v in value)


def _frames(path: Path, table: dict[str, Any], problems: Problems) -> tuple[int, int | None, int]:
    first, last, every = table.get("first", 0), table.get("last"), table.get("every", 1)
    for name, value, least in (("first", first, 0), ("last", last, 0), ("every", every, 1)):
        if value is not None and (type(value) is not int or value < least):
            problems.add(path, f"frames.{name}: expected a whole number of at least {least}, found {value!r}")
    return first, last, every
