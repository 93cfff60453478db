"""A flat calibration board: what it is made of, and where its corners lie."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems, nearest
from bcid.base.units import quantity

Array = NDArray[np.float64]

CHESSBOARD, CHARUCO = "chessboard", "charuco"


@dataclass(frozen=True)
class Board:
    """A flat calibration board.

    Attributes:
        kind: "chessboard" or "charuco".
        columns, rows: inner corners of a chessboard, squares of a ChArUco board.
        square, marker: sides of its squares and of its markers (0 for a chessboard), m.
        dictionary: OpenCV's name of the markers' dictionary.
        legacy: whether the ChArUco board has the layout that OpenCV printed before version 4.6.
    """

    kind: str
    columns: int
    rows: int
    square: float
    marker: float = 0.0
    dictionary: str = ""
    legacy: bool = False

    @classmethod
    def parse(cls, text: str) -> Board:
        """A board written as "chessboard 10x7 10 mm" or "charuco 8x6 30 mm 22 mm DICT_5X5_100".

        The chessboard's numbers are its inner corners and the side of a square; the ChArUco board's are its squares, the sides of
        a square and of a marker, and the dictionary of the markers ("legacy" behind it: layout of OpenCV before 4.6).

        Raises:
            InputError: with everything that is wrong.
        """
        words = text.split()
        kind = words[0].lower() if words else ""
        example = f'"{CHESSBOARD} 10x7 10 mm" or "{CHARUCO} 8x6 30 mm 22 mm DICT_5X5_100"'
        problems = Problems(f"board '{text}'")
        if kind not in (CHESSBOARD, CHARUCO):
            problems.add("kind", f"expected {example}")
            problems.raise_if_any()
        legacy = kind == CHARUCO and words[-1] == "legacy"
        dictionary, tail = "", words[1 : len(words) - legacy]
        if kind == CHARUCO:
            dictionary, tail = (tail[-1], tail[:-1]) if tail and tail[-1].startswith("DICT") else ("", tail)
            if not dictionary:
                problems.add("dictionary", f"is missing; write as {example}")
        columns, rows = _counts(tail[0] if tail else "", kind, problems)
        sides = _sides(" ".join(tail[1:]), 2 if kind == CHARUCO else 1, example, problems)
        board = cls(kind, columns, rows, sides[0], sides[1] if kind == CHARUCO else 0.0, dictionary, legacy)
        if kind == CHARUCO and not problems.found:
            board._check_markers(problems)
        problems.raise_if_any()
        return board

    @property
    def points(self) -> Array:
        """All corners (n, 3), m, row by row, in the order of OpenCV's numbers of ChArUco corners; z is 0."""
        columns, rows, first = (
            (self.columns, self.rows, 0) if self.kind == CHESSBOARD else (self.columns - 1, self.rows - 1, 1)
        )
        y, x = np.mgrid[first : rows + first, first : columns + first]
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * self.square

    def __str__(self) -> str:
        size = f"{self.kind} {self.columns}x{self.rows} {self.square * 1e3:g} mm"
        if self.kind == CHESSBOARD:
            return size
        return f"{size} {self.marker * 1e3:g} mm {self.dictionary}" + (" legacy" if self.legacy else "")

    def _check_markers(self, problems: Problems) -> None:
        import cv2

        known = [name for name in dir(cv2.aruco) if re.fullmatch(r"DICT_[0-9A-Z_]+", name, re.IGNORECASE)]
        if self.dictionary not in known:
            problems.add("dictionary", f"'{self.dictionary}' is not known; {nearest(self.dictionary, known)}")
        else:
            held = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary)).bytesList)
            if held < (needed := self.columns * self.rows // 2):
                problems.add(
                    "dictionary", f"{self.dictionary} has {held} markers, the board needs {needed}; take a larger one"
                )
        if self.marker >= self.square:
            problems.add(
                "marker",
                f"its side ({self.marker * 1e3:g} mm) must be smaller than that of a square ({self.square * 1e3:g} mm)",
            )


def _counts(text: str, kind: str, problems: Problems) -> tuple[int, int]:
    what = "inner corners" if kind == CHESSBOARD else "squares"
    match = re.fullmatch(r"([0-9]{1,4})[xX×]([0-9]{1,4})", text)
    if not match:
        problems.add(what, f"expected columns x rows as 10x7, found '{text}'")
        return 3, 3
    columns, rows = int(match[1]), int(match[2])
    # The same number of corners for both kinds of board.
    least = 3 if kind == CHESSBOARD else 4
    if min(columns, rows) < least or max(columns, rows) > 200:
        problems.add(what, f"expected {least} to 200 columns and rows, found {columns}x{rows}")
    return columns, rows


def _sides(text: str, count: int, example: str, problems: Problems) -> list[float]:
    """Lengths with units, m."""
    parts = re.findall(r"[-+0-9.,eE]+\s*[^\s0-9]*", text)
    names = ("square", "marker")[:count]
    if len(parts) != count or "".join(parts).replace(" ", "") != text.replace(" ", ""):
        problems.add(" and ".join(names), f"expected {count} length(s) with unit, found '{text}'; write as {example}")
        return [0.0] * count
    sides = []
    for name, part in zip(names, parts, strict=True):
        try:
            side = quantity(part, "m")
        except InputError as error:
            problems.add(name, str(error))
            side = 1.0
        if not 0 < side < 100:
            problems.add(name, f"expected a length above 0, found '{part.strip()}'")
        sides.append(side)
    return sides
