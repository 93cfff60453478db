"""A calibration object whose points are known in space, and where they were picked in images: two tables of text."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems, nearest
from bcid.base.text_file import read_lines
from bcid.base.units import FURTHEST, unit_factor
from bcid.vision.corners import Corners

Array = NDArray[np.float64]

_AXES = ("x", "y", "z")
_PIXELS = ("u_left", "v_left", "u_right", "v_right")
# No pixel is further from the first.
_WIDEST = 1e6


@dataclass(frozen=True)
class KnownPoints:
    """A calibration object.

    Attributes:
        source: the file.
        places: of its points by name, shape (3,), m, in right-handed axes of its own.
    """

    source: Path
    places: dict[str, Array]

    @classmethod
    def read(cls, path: Path) -> KnownPoints:
        """Read a CSV file with columns name, x_mm, y_mm, z_mm, or with another unit in the place of mm.

        Raises:
            InputError: with everything that is wrong.
        """
        problems = Problems(f"points of the board {path}")
        header, rows = _table(path, "no such file of known points")
        matches = [re.fullmatch(r"([xyz])_(\w+)", name) for name in header]
        units = {match[2] for match in matches if match}
        named = [match[1] if match else name for name, match in zip(header, matches, strict=True)]
        columns = _columns(named, ("name", *_AXES), path, problems)
        scale = 1.0
        if len(units) != 1:
            problems.add(path, "x, y, z: one unit is needed for the three; name the columns x_mm, y_mm, z_mm", 1)
        else:
            try:
                scale = unit_factor(units.pop(), "m")
            except InputError as error:
                problems.add(path, f"x, y, z: {error}", 1)
        problems.raise_if_any()
        places: dict[str, Array] = {}
        for line, cells in rows:
            name = cells[columns["name"]] if _whole(cells, header, path, line, problems) else ""
            if not name:
                continue
            if name in places:
                problems.add(path, f"point {name} stands twice", line)
            place = [_number(cells[columns[axis]], axis, FURTHEST, path, line, problems) for axis in _AXES]
            if any(map(math.isnan, place)):
                problems.add(path, f"point {name}: its place is not complete", line)
            places[name] = scale * np.array(place)
        problems.raise_if_any()
        return cls(path, places)

    def picked(self, path: Path, first: float = 0.0) -> list[Corners]:
        """Read where the points were picked: a CSV file with columns name, u_left, v_left, u_right, v_right, and pose.

        Rows where a camera did not see the point leave its cells empty; without a column pose (a whole number) all are of one.

        Args:
            path: the file.
            first: coordinate of the middle of the first pixel in the file: 0, or 1 as in MATLAB.

        Raises:
            InputError: with everything that is wrong.
        """
        problems = Problems(f"picked points {path}")
        header, rows = _table(path, "no such file of picked points")
        header = ["pose" if name == "pair" else name for name in header]
        columns = _columns(header, ("name", *_PIXELS), path, problems, ("pose",))
        problems.raise_if_any()
        poses: dict[int, dict[str, list[float]]] = {}
        for line, cells in rows:
            if not _whole(cells, header, path, line, problems):
                continue
            name, pose = cells[columns["name"]], cells[columns["pose"]] if "pose" in columns else "0"
            if name not in self.places:
                problems.add(path, f"point '{name}' is none of {self.source}; {nearest(name, self.places)}", line)
            if not re.fullmatch(r"[0-9]{1,9}", pose, re.ASCII):
                problems.add(path, f"pose: expected a whole number, found '{pose}'", line)
                continue
            found = poses.setdefault(int(pose), {})
            if name in found:
                problems.add(path, f"point {name} of pose {pose} stands twice", line)
            found[name] = [_number(cells[columns[key]], key, _WIDEST, path, line, problems) for key in _PIXELS]
        problems.raise_if_any()
        return [self._corners(pose, found, first) for pose, found in sorted(poses.items())]

    def _corners(self, pose: int, found: dict[str, list[float]], first: float) -> Corners:
        """What both cameras saw of a pose."""
        both = {name: pixels for name, pixels in found.items() if all(map(math.isfinite, pixels))}
        pixels = np.array(list(both.values())).reshape(-1, 4) - first
        board = np.array([self.places[name] for name in both]).reshape(-1, 3)
        return Corners(pose, board, pixels[:, :2], pixels[:, 2:], tuple(both))


def _table(path: Path, absent: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Names of the columns, and rows of cells with the number of their line."""
    reader = csv.reader(read_lines(path, absent))
    try:
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row))]
    except csv.Error as error:
        raise InputError(f"{path}:{reader.line_num}: is not a table: {error}") from None
    if not rows:
        raise InputError(f"{path}: is empty; expected a table with the names of its columns in the first row")
    return rows[0][1], rows[1:]


def _columns(
    header: list[str], wanted: tuple[str, ...], path: Path, problems: Problems, others: tuple[str, ...] = ()
) -> dict[str, int]:
    """Where each column stands."""
    for name in sorted({name for name in header if header.count(name) > 1}):
        problems.add(path, f"column {name} stands twice", 1)
    missing = [name for name in wanted if name not in header]
    if missing:
        problems.add(path, f"column {', '.join(missing)} is missing; expected {', '.join(wanted)}", 1)
    return {name: header.index(name) for name in (*wanted, *others) if name in header}


def _whole(cells: list[str], header: list[str], path: Path, line: int, problems: Problems) -> bool:
    if len(cells) != len(header):
        problems.add(path, f"has {len(cells)} values, the header names {len(header)} columns", line)
    return len(cells) == len(header)


def _number(text: str, name: str, most: float, path: Path, line: int, problems: Problems) -> float:
    """A number of a cell; NaN where it is empty, or no number, which is noted."""
    try:
        number = float(text) if text else math.nan
    except ValueError:
        number = math.inf
    if abs(number) > most:
        problems.add(path, f"{name}: expected a number up to {most:g}, found '{text[:60]}'", line)
        return 0.0
    return number
