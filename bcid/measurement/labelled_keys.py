"""The keys of a mapping that are for recordings which name their markers: [points], [arrays] and labels in [columns]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bcid.base.errors import Problems
from bcid.measurement.formats.array_file import DIMENSIONS
from bcid.measurement.formats.foreign import CORRELATION
from bcid.measurement.formats.recognise import Format

# Keys of [points] and [arrays].
POINTS = ("every", "least_score", "most_error", "least_cameras", "least_correlation")
ARRAYS = ("positions", "displacements", "rest", "grid", "order", "names", "quality")
# The quality that each bound is for, and whether it is a least one.
BOUNDS = {"least_score": ("score", True), "most_error": ("error", False), "least_cameras": ("cameras", True)}
BOUNDS["least_correlation"] = (CORRELATION, True)
# Columns that only a table with a header line has.
_OF_TABLES = ("action", "step", "fiducial", "position", "grasp", "translation", "rotation")


def check_points(path: Path, found: Format, tables: dict[str, dict[str, Any]], problems: Problems) -> None:
    """Note what is wrong in the keys of a mapping that are for files with labels."""
    points, columns = tables["points"], tables["columns"]
    every = points.get("every", 1)
    if type(every) is not int or every < 1:
        problems.add(path, f"points.every: expected a whole number of at least 1, found {every!r}")
    for key in BOUNDS:
        if key in points and type(points[key]) not in (int, float):
            problems.add(path, f"points.{key}: expected a number, found {points[key]!r}")
    for key in _OF_TABLES if found.name != "c3d" else ():
        if key in columns and not (found.series and key == "step"):
            problems.add(
                path, f"columns.{key}: is for tables with a header line; a {found.words} names its markers itself"
            )
    for key in ("time", "pose", "wrench"):
        if key in columns and not (isinstance(columns[key], str) and columns[key]):
            what = "path of an array" if found.arrays else "label in the file"
            problems.add(path, f"columns.{key}: expected one {what}, found {columns[key]!r}")
    if found.series:
        _check_series(path, columns, problems)
    if found.arrays:
        _check_arrays(path, tables["arrays"], problems)
    elif tables["arrays"]:
        problems.add(path, f"arrays: is for MAT, HDF5 and NPZ files; this is a {found.words}")


def _check_series(path: Path, columns: dict[str, Any], problems: Problems) -> None:
    for key in ("rest", "displacement"):
        if key in columns and not _paths(columns[key], (3,)):
            problems.add(path, f"columns.{key}: expected the names of 3 columns, found {columns[key]!r}")
    if ("rest" in columns) != ("displacement" in columns):
        problems.add(path, "columns.rest and columns.displacement: give both or neither")
    for key in ("point", "quality"):
        if not isinstance(columns.get(key, "x"), str):
            problems.add(path, f"columns.{key}: expected the name of a column, found {columns[key]!r}")


def _check_arrays(path: Path, arrays: dict[str, Any], problems: Problems) -> None:
    if ("positions" in arrays) == ("displacements" in arrays):
        advice = 'as positions = "tracks/xyz"; `bcid import FILE` lists what is in it'
        problems.add(path, f"arrays: name either the array of positions or that of displacements, {advice}")
    for key in ("positions", "displacements", "rest"):
        if key in arrays and not (isinstance(arrays[key], str) and arrays[key]) and not _paths(arrays[key], (2, 3)):
            problems.add(path, f"arrays.{key}: expected a path, or one for each axis, found {arrays[key]!r}")
    if "displacements" in arrays and ("rest" in arrays) == ("grid" in arrays):
        problems.add(path, "arrays.displacements: needs arrays.rest, the rest positions, or arrays.grid, their spacing")
    if "grid" in arrays and not (type(arrays["grid"]) in (int, float) and 0 < arrays["grid"] < 1e6):
        problems.add(path, f"arrays.grid: expected a positive number in length_unit, found {arrays['grid']!r}")
    order = str(arrays.get("order", " ".join(DIMENSIONS))).split()
    if not {"marker"} <= set(order) <= set(DIMENSIONS) or len(set(order)) != len(order):
        problems.add(
            path,
            f'arrays.order: expected the words of "{" ".join(DIMENSIONS)}" in any order, found {arrays["order"]!r}',
        )
    elif isinstance(arrays.get("positions", arrays.get("displacements")), str) and "axis" not in order:
        problems.add(path, "arrays.order: one array of all three axes has the dimension axis")
    for key in ("names", "quality"):
        if not isinstance(arrays.get(key, ""), str):
            problems.add(path, f"arrays.{key}: expected a path, found {arrays[key]!r}")


def _paths(value: object, counts: tuple[int, ...]) -> bool:
    return isinstance(value, list) and len(value) in counts and all(isinstance(v, str) and v for v in value)
