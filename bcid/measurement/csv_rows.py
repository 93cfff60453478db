"""Tables of others: rows under a header line, and the numbers of some of their columns."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems, nearest
from bcid.base.text_file import read_lines

Array = NDArray[np.float64]
# Number of the line, for messages, and cells by column.
Row = tuple[int, dict[str, str]]


def csv_rows(file: Path, delimiter: str) -> list[Row]:
    """The rows of a file that are not empty.

    Raises:
        InputError: it holds none, or rows of another length than its header.
    """
    reader = csv.reader(read_lines(file), delimiter=delimiter)
    problems = Problems(f"recording {file}")
    rows = []
    try:
        header = [name.strip() for name in next(reader, [])]
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                problems.add(file, f"has {len(row)} values, the header names {len(header)} columns", reader.line_num)
                continue
            rows.append((reader.line_num, {name: cell.strip() for name, cell in zip(header, row, strict=True)}))
    except csv.Error as error:
        problems.add(file, f"is not a table: {error}", reader.line_num)
        rows = []
    if not rows:
        problems.add(file, "holds no rows; is the delimiter right?")
    problems.raise_if_any()
    return rows


def require(file: Path, rows: Sequence[Row], columns: Iterable[str], problems: Problems) -> None:
    """Refuse columns that a file does not have; those without a name were not measured.

    Raises:
        InputError: with these, and the problems before.
    """
    known = rows[0][1]
    for column in dict.fromkeys(columns):
        if column and column not in known:
            problems.add(file, f"has no column '{column}'; {nearest(column, known)}", 1)
    problems.raise_if_any()


def numbers(
    file: Path, rows: Sequence[Row], columns: Sequence[str], decimal: str, problems: Problems, gaps: bool = False
) -> Array:
    """Numbers of some columns, shape (rows, columns); NaN of columns without a name, and of empty cells where gaps are allowed."""
    values = np.full((len(rows), len(columns)), np.nan)
    for i, (line, row) in enumerate(rows):
        for j, column in enumerate(columns):
            cell = row[column] if column else ""
            if not column or (gaps and (not cell or cell.lower() == "nan")):
                continue
            try:
                values[i, j] = float(cell.replace(decimal, "."))
            except ValueError:
                values[i, j] = np.inf
            if not math.isfinite(values[i, j]):
                problems.add(file, f"{column}: expected a finite number, found '{cell}'", line)
                values[i, j] = 0.0
    return values
