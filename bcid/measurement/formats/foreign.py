"""What readers of foreign files share: what a file holds, what a mapping says of it, processes of their own, tables of cells."""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Iterable, Sequence
from collections.abc import Mapping as Table
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import read_in_child
from bcid.base.errors import InputError, Problems
from bcid.base.text_file import read_export

Array = NDArray[np.float64]
# The quality of a point of image or volume correlation: 1 is best, 0 that it was not correlated.
CORRELATION = "correlation"
# Time of a reader, s, and how much more a byte of the file may take.
_SECONDS, _SECONDS_PER_BYTE = 30.0, 1e-6
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


@dataclass(frozen=True)
class Foreign:
    """Markers, rigid bodies and forces by their labels in the file, along one axis of frames.

    Attributes:
        format: in words.
        times: of the frames, s, shape (frames,).
        points: positions by label, shape (frames, 3), in `unit`; NaN where a marker was not seen.
        bodies: poses of rigid bodies by label, shape (frames, 7): position in `unit`, unit quaternion (w, x, y, z).
        wrenches: by label, shape (frames, 6): force, N, and torque, as the file has them.
        quality: by kind ("score", "error", "cameras", "correlation") and label, shape (frames,).
        unit: of lengths; "" if the file states none.
        numbered: whether the points have no names but numbers from 1.
        clocked: whether the file, or the mapping, says when its frames were taken; if not, one is a time_unit.
        rest: positions without stress by label, shape (3,), where the file has them beside those of its frames.
        displacements: whether the file has displacements, which count from `rest`.
        empty: labels that the file names and holds no data for.
        notes: what was not read, to be told by `bcid import`.
    """

    format: str
    times: Array
    points: dict[str, Array]
    bodies: dict[str, Array] = field(default_factory=dict)
    wrenches: dict[str, Array] = field(default_factory=dict)
    quality: dict[str, dict[str, Array]] = field(default_factory=dict)
    unit: str = ""
    numbered: bool = False
    clocked: bool = True
    rest: dict[str, Array] = field(default_factory=dict)
    displacements: bool = False
    empty: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.times)

    def correlated(self, quality: Array) -> Foreign:
        """The same with the correlation of each point, (frames, points), NaN where there is none; those without any are lost.

        Where no point has any it is no such measure, and nothing is lost.
        """
        lost = ~(quality > 0)
        if lost.all():
            return replace(self, notes=(*self.notes, "the quality of all points is 0: it is not used"))
        points = {
            label: np.where(gone[:, None], np.nan, at)
            for (label, at), gone in zip(self.points.items(), lost.T, strict=True)
        }
        each = dict(zip(self.points, quality.T, strict=True))
        count = int((lost & np.isfinite(np.stack([at[:, 0] for at in self.points.values()], axis=1))).sum())
        notes = (f"positions without a correlation count as not seen: {count}",) if count else ()
        return replace(self, points=points, quality={**self.quality, CORRELATION: each}, notes=(*self.notes, *notes))

    @property
    def rate(self) -> float:
        """Frames per second, from the median interval; NaN for less than two frames."""
        steps = np.diff(self.times)
        middle = float(np.median(steps)) if len(steps) else 0.0
        return 1.0 / middle if middle > 0 else float("nan")


@dataclass(frozen=True)
class How:
    """What a mapping says of how to read a file; formats take what concerns them.

    Attributes:
        arrays: the table [arrays]: paths of arrays and the order of their dimensions.
        columns: the table [columns]; of files with arrays, paths of them.
        time: the mapping's time_unit, s.
        rate: frames per second of a file without times; None for one in each time_unit.
        clock: label of a marker whose times are those of the frames; of ROS bags.
    """

    arrays: Table[str, Any] = field(default_factory=dict)
    columns: Table[str, Any] = field(default_factory=dict)
    time: float = 1.0
    rate: float | None = None
    clock: str = ""

    def count(self, frames: int) -> Array:
        """Times of the frames of a file that has none, s, shape (frames,)."""
        return np.asarray(np.arange(frames) * (self.time if self.rate is None else 1.0 / self.rate))


def fetched(
    module: str, path: Path, what: str, arguments: Sequence[str] = (), *, in_place: bool = False
) -> dict[str, Any]:
    """Arrays by name that a reader makes of a file; see `bcid.base.confined.read_in_child`.

    Raises:
        InputError: the file is no readable `what`.
    """
    limit = _SECONDS + _SECONDS_PER_BYTE * path.stat().st_size
    try:
        return read_in_child(module, path, arguments, seconds=limit, in_place=in_place)
    except (InputError, TimeoutError) as error:
        raise InputError(f"{path}: is not a readable {what}: {error}; is it whole? Export or copy it again") from None


def needed(package: str) -> InputError:
    """That a package is missing, as the reader in the child says it."""
    return InputError(f"reading it needs the package {package}; install bcid[mocap]")


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


def length_unit(text: str) -> str:
    """The sign of a unit of length that a file states as a word or a sign; what is not known stays as it is."""
    plain = text.strip().lower()
    return _LENGTHS.get(plain.removesuffix("s"), plain if plain in _LENGTHS.values() else text.strip())


def whole(xyz: Array) -> Array:
    """Positions (frames, 3) that are NaN as a whole where a coordinate is."""
    return np.where(np.isfinite(xyz).all(axis=1, keepdims=True), xyz, np.nan)


@dataclass(frozen=True)
class Export:
    """A table of text with several header lines: `what` it is, in words, and its rows that hold something."""

    path: Path
    what: str
    rows: list[Row]

    @classmethod
    def read(cls, path: Path, delimiter: str, what: str) -> Export:
        """The rows of a file; see `read_grid`."""
        return cls(path, what, filled(read_grid(path, delimiter)))

    def need(self, count: int) -> None:
        """Refuse a file that ends within its header."""
        if len(self.rows) < count:
            raise InputError(f"{self.path}: ends within the header of {self.what}; is it cut off? Export it again")

    def number(self, text: str, what: str, line: int) -> float:
        """A number of a header that must be positive.

        Raises:
            InputError: it is none.
        """
        try:
            value = float(text.replace(",", "."))
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value > 0):
            raise InputError(
                f"{self.path}:{line}: {what}: expected a positive number, found '{text}'; export the file again"
            )
        return value

    def numbers(self, rows: Sequence[Row], width: int, used: Collection[int] | None = None) -> Array:
        """The cells of the data, shape (rows, width); empty cells are NaN, a decimal comma is a point.

        Of columns that are not in `used` (all, if it is None) nothing is read: they may hold text, and are NaN.

        Raises:
            InputError: there are no rows, or with every row that is short or holds other than numbers.
        """
        problems = Problems(f"recording {self.path}")
        values = np.full((len(rows), width), np.nan)
        if not rows:
            problems.add(self.path, f"holds no frame: {self.what} ends behind its header; export it again")
        for i, (line, cells) in enumerate(rows):
            if len(cells) < width or any(cells[width:]):
                said = f"has {len(cells)} values, the header names {width} columns; is the file cut off?"
                problems.add(self.path, said, line)
                continue
            for j in range(width) if used is None else used:
                values[i, j] = self._cell(cells[j], line, problems)
        problems.raise_if_any()
        return values

    def _cell(self, cell: str, line: int, problems: Problems) -> float:
        if not cell or cell.lower() == "nan":
            return math.nan
        try:
            value = float(cell.replace(",", "."))
        except ValueError:
            value = math.inf
        if not math.isfinite(value):
            problems.add(self.path, f"expected a number or an empty cell, found '{cell}'", line)
        return value

    def distinct(self, labels: Iterable[str]) -> None:
        """Refuse labels that stand twice."""
        seen: set[str] = set()
        for label in labels:
            if label in seen:
                raise InputError(
                    f"{self.path}: names the marker '{label}' twice; rename one of them where it was recorded"
                )
            seen.add(label)
