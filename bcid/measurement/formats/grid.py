"""Tables of text with several header lines, as cells: what their readers share."""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems
from bcid.base.text_file import read_export

Array = NDArray[np.float64]
Row = tuple[int, list[str]]

# Units of length as programs spell them out.
_LENGTHS = {
    "meter": "m",
    "metre": "m",
    "centimeter": "cm",
    "millimeter": "mm",
    "micrometer": "um",
    "inch": "in",
    "inche": "in",
}


def read_grid(path: Path, delimiter: str) -> list[Row]:
    """Lines of a table as (number of the line, stripped cells), empty ones included.

    Raises:
        InputError: it is no text, or no table.
    """
    reader = csv.reader(read_export(path), delimiter=delimiter)
    rows: list[Row] = []
    try:
        for cells in reader:
            rows.append((reader.line_num, [cell.strip() for cell in cells]))
    except csv.Error as error:
        raise InputError(f"{path}:{reader.line_num}: is not a table: {error}") from None
    return rows


def filled(rows: Iterable[Row]) -> list[Row]:
    """The rows that hold something."""
    return [row for row in rows if any(row[1])]


def need(path: Path, rows: Sequence[Row], count: int, what: str) -> None:
    """Refuse a file that ends within its header."""
    if len(rows) < count:
        raise InputError(f"{path}: ends within the header of {what}; is it cut off? Export it again")


def number(path: Path, text: str, what: str, line: int) -> float:
    """A number of a header that must be positive.

    Raises:
        InputError: it is none.
    """
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{path}:{line}: {what}: expected a positive number, found '{text}'; export the file again")
    return value


def length_unit(text: str) -> str:
    """The sign of a unit of length that a file states as a word or a sign; what is not known stays as it is."""
    plain = text.strip().lower()
    return _LENGTHS.get(plain.removesuffix("s"), plain if plain in _LENGTHS.values() else text.strip())


def numbers(path: Path, rows: Sequence[Row], width: int, what: str, used: Collection[int] | None = None) -> Array:
    """The cells of the data, shape (rows, width); empty cells are NaN, a decimal comma is a point.

    Of columns that are not in `used` (all, if it is None) nothing is read: they may hold text, and are NaN.

    Raises:
        InputError: there are no rows, or with every row that is short or holds other than numbers.
    """
    problems = Problems(f"recording {path}")
    values = np.full((len(rows), width), np.nan)
    if not rows:
        problems.add(path, f"holds no frame: {what} ends behind its header; export it again")
    for i, (line, cells) in enumerate(rows):
        if len(cells) < width or any(cells[width:]):
            said = f"has {len(cells)} values, the header names {width} columns; is the file cut off?"
            problems.add(path, said, line)
            continue
        for j in range(width) if used is None else used:
            values[i, j] = _number(path, cells[j], line, problems)
    problems.raise_if_any()
    return values


def _number(path: Path, cell: str, line: int, problems: Problems) -> float:
    if not cell or cell.lower() == "nan":
        return math.nan
    try:
        value = float(cell.replace(",", "."))
    except ValueError:
        value = math.inf
    if not math.isfinite(value):
        problems.add(path, f"expected a number or an empty cell, found '{cell}'", line)
    return value


def whole(xyz: Array) -> Array:
    """Positions (frames, 3) that are NaN as a whole where a coordinate is."""
    return np.where(np.isfinite(xyz).all(axis=1, keepdims=True), xyz, np.nan)


def distinct(path: Path, labels: Iterable[str]) -> None:
    """Refuse labels that stand twice."""
    seen: set[str] = set()
    for label in labels:
        if label in seen:
            raise InputError(f"{path}: names the marker '{label}' twice; rename one of them where it was recorded")
        seen.add(label)
