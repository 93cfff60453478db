"""The table surface.csv of a measurement folder: points of the surface, any number in each step."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import xarray as xr

from bcid.base.text_file import read_lines
from bcid.measurement.cloud import Cloud, Frame

FILE = "surface.csv"
_AXES = ("x", "y", "z")


class TableReader(Protocol):
    """What of the reader of a folder reads its tables."""

    def bad(self, line: int | None, text: str) -> None:
        """Note what is wrong in a line."""

    def columns(self, columns: list[str], required: list[str], optional: list[str]) -> Any:
        """The columns that a header names, as an object whose `columns` are empty where they cannot be used."""

    def number(self, line: int, row: dict[str, str], column: str) -> float:
        """A finite number."""

    def frame(self, line: int, row: dict[str, str], last: dict[str, int]) -> Frame | None:
        """Action and step of a row."""


def written(value: float) -> str:
    """A number as the tables have it; nothing for NaN."""
    return "" if math.isnan(value) else f"{value:.12g}"


def read_table(reader: TableReader, path: Path, length: float) -> Cloud | None:
    """The points (m); None where there is no such file, or it cannot be used."""
    if not path.exists():
        return None
    lines = csv.reader(read_lines(path))
    frames: dict[Frame, int] = {}
    values: list[list[float]] = []
    try:
        columns = [name.strip() for name in next(lines, [])]
        required = ["action", "step", "time", *_AXES]
        if not reader.columns(columns, required, ["sigma"]).columns:
            return None
        values = list(_rows(reader, lines, columns, frames))
    except csv.Error as error:
        reader.bad(lines.line_num, f"is not a table: {error}")
    if not values:
        reader.bad(None, "holds no point")
        return None
    table = np.array(values)
    points, sigma = table[:, 1:4] * length, table[:, 4] * length
    return Cloud(points, sigma, tuple(frames), table[:, 0].astype(np.int64))


def _rows(reader: TableReader, lines: Any, columns: list[str], frames: dict[Frame, int]) -> Iterator[list[float]]:
    """Number of the frame, x, y, z and sigma of each row; `frames` gets the frames with their numbers."""
    named = [columns.index(name) for name in ("action", "step", "time")]
    numeric = [columns.index(name) for name in (*_AXES, "sigma") if name in columns]
    last: dict[str, int] = {}
    known: dict[tuple[str, ...], int] = {}
    for row in lines:
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(columns):
            reader.bad(lines.line_num, f"has {len(row)} values, the header names {len(columns)} columns")
            continue
        key = tuple(row[k].strip() for k in named)
        if key not in known:
            frame = reader.frame(lines.line_num, dict(zip(("action", "step", "time"), key, strict=True)), last)
            if frame is None:
                continue
            known[key] = frames.setdefault(frame, len(frames))
        cells = {columns[k]: row[k].strip() for k in numeric}
        place = [reader.number(lines.line_num, cells, axis) for axis in _AXES]
        yield [known[key], *place, _sigma(reader, lines.line_num, cells)]


def _sigma(reader: TableReader, line: int, cells: dict[str, str]) -> float:
    """Standard deviation of a point, in the file's unit; NaN where none is stated."""
    if not cells.get("sigma"):
        return math.nan
    value = reader.number(line, cells, "sigma")
    if value <= 0:
        reader.bad(line, f"sigma: expected a positive number, found '{cells['sigma']}'")
    return value


def table_lines(cloud: Cloud, data: xr.Dataset, head: list[str], length: float) -> list[str]:
    """Lines of a surface.csv; `head` has action, step and time of each frame."""
    numbers = cloud.numbers(data)
    stated = bool(np.isfinite(cloud.sigma).any())
    lines = ["action,step,time,x,y,z" + (",sigma" if stated else "")]
    for k in np.argsort(numbers, kind="stable"):
        if numbers[k] >= 0:
            values = [*cloud.points[k], cloud.sigma[k]] if stated else cloud.points[k]
            lines.append(f"{head[numbers[k]]},{','.join(written(v / length) for v in values)}")
    return lines
