"""Corners of a board that both cameras saw: found in images, or read from a table. Pairs of images are named by their number."""

from __future__ import annotations

import csv
import gzip
import math
import re
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems
from bcid.base.progress import Progress
from bcid.base.text_file import as_lines, read_lines, refuse_longer
from bcid.base.units import unit_factor
from bcid.vision.board import CHESSBOARD, Board
from bcid.vision.camera import SIDES
from bcid.vision.images import Image, Images

Array = NDArray[np.float64]

# Corners that a pair must show.
CORNERS = 6
# Pairs to look at; of more, so many are picked evenly.
_MOST = 100
# Longest table that is unpacked, bytes: a million corners.
_LONGEST_UNPACKED = 100_000_000
# Columns of a table that hold lengths and pixels.
_SIX = ("x", "y", "u1", "v1", "u2", "v2")
# No corner is further from the first, in pixels or in units of length.
_FURTHEST = 1e6


@dataclass(frozen=True)
class Corners:
    """What one pair of images showed of the board.

    Attributes:
        number: of the pair.
        board: corners that both cameras saw, on the board, shape (n, 3), m; z is 0 for a pattern that is found in images.
        left, right: the same corners in the images, shape (n, 2), px.
        names: of points that were picked; empty for corners of a pattern.
    """

    number: int
    board: Array
    left: Array
    right: Array
    names: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.board)


def find_corners(left: Images, right: Images, board: Board, progress: Progress) -> tuple[list[Corners], dict[int, str]]:
    """Corners of the board in the pairs of two cameras, to fractions of a pixel; of many pairs, 100 are looked at.

    Returns:
        Corners of the pairs that show the board, and why the other pairs do not, by number.
    """
    missing: dict[int, str] = {}
    for number in sorted(set(left.numbers) ^ set(right.numbers)):
        missing[number] = f"is only in {left.source if number in left.numbers else right.source}"
    numbers = sorted(set(left.numbers) & set(right.numbers))
    if len(numbers) > _MOST:
        numbers = [numbers[i] for i in np.linspace(0, len(numbers) - 1, _MOST).round().astype(int)]
    found = []
    for count, number in enumerate(numbers, start=1):
        progress.step("corners of the board in pairs", count, len(numbers))
        pair = _pair(left, right, board, number)
        if isinstance(pair, str):
            missing[number] = pair
        else:
            found.append(pair)
    return found, dict(sorted(missing.items()))


def _pair(left: Images, right: Images, board: Board, number: int) -> Corners | str:
    """Corners that both images of a number show, or why there are none."""
    seen = []
    for side, images in zip(SIDES, (left, right), strict=True):
        image = images.read(number)
        if image is None:
            return f"{side}: {images.troubles[number]}"
        corners = corners_in(image, board)
        if isinstance(corners, str):
            return f"{side}: {corners}"
        seen.append(corners)
    both = sorted(seen[0].keys() & seen[1].keys())
    points = board.points[both]
    if len(both) < CORNERS or np.linalg.matrix_rank(points[:, :2] - points[0, :2], tol=board.square / 2) < 2:
        return f"only {len(both)} corners are seen by both cameras, or they lie on a line; {CORNERS} are needed"
    first, second = (np.array([corners[i] for i in both]) for corners in seen)
    return Corners(number, points, first, second)


def corners_in(image: Image, board: Board) -> dict[int, Array] | str:
    """Pixels (2) of the corners in an image, by their number on the board (see `Board.points`), or why there are none."""
    return _chessboard(image, board) if board.kind == CHESSBOARD else _charuco(image, board)


def _chessboard(image: Image, board: Board) -> dict[int, Array] | str:
    """The corners are moved to where grey changes meet, unless the image is so blurred that this makes them worse."""
    import cv2

    size = (board.columns, board.rows)
    good, corners = cv2.findChessboardCornersSB(
        image, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    )
    if not good:
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        good, corners = cv2.findChessboardCorners(image, size, flags=flags)
    if not good:
        return f"no chessboard with {board.columns}x{board.rows} inner corners is found; all of it must be seen, with a white rim"
    first: Array = np.asarray(corners, dtype=float).reshape(board.rows, board.columns, 2)
    grid = min(_refined(image, first), first, key=_unevenness)
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0:
        # A board that is looked at from its front is never mirrored.
        grid = grid[:, ::-1]
    return dict(enumerate(grid.reshape(-1, 2)))


def _refined(image: Image, grid: Array) -> Array:
    """Corners (rows, columns, 2) moved to where grey changes meet, in a window that reaches no neighbour."""
    import cv2

    gaps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
    half = int(np.clip(0.4 * min(gaps), 2, 15))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-3)
    corners = np.ascontiguousarray(grid.reshape(-1, 1, 2), dtype=np.float32)
    moved = cv2.cornerSubPix(image, corners, (half, half), (-1, -1), stop)
    return np.asarray(moved, dtype=float).reshape(grid.shape)


def _unevenness(grid: Array) -> float:
    """RMS distance of corners (rows, columns, 2) from the best perspective picture of an even grid, px."""
    import cv2

    y, x = np.mgrid[0 : grid.shape[0], 0 : grid.shape[1]]
    even = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    found = grid.reshape(-1, 2)
    homography = cv2.findHomography(even, found, 0)[0]
    if homography is None:
        return math.inf
    return rms(cv2.perspectiveTransform(even[:, None], homography)[:, 0] - found)


def _charuco(image: Image, board: Board) -> dict[int, Array] | str:
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)
    if board.legacy:
        pattern.setLegacyPattern(True)
    options = cv2.aruco.CharucoParameters()
    # Markers that are missed at first are looked for where the others say they are.
    options.tryRefineMarkers = True
    corners, numbers, _, markers = cv2.aruco.CharucoDetector(pattern, options).detectBoard(image)
    if numbers is None or len(numbers) == 0:
        if markers is not None and len(markers):
            return (
                f"{len(markers)} marker(s) are found, but no corner between them; show more of the board, check its number of "
                "squares, or write 'legacy' behind it"
            )
        return f"no marker of {board.dictionary} is found"
    pixels = np.asarray(corners, dtype=float).reshape(-1, 2)
    return dict(zip(np.asarray(numbers).ravel().tolist(), pixels, strict=True))


def rms(vectors: Array) -> float:
    """Root of the mean squared length of vectors (n, 2)."""
    return math.sqrt(float(np.sum(vectors**2)) / len(vectors))


def read_corners(path: Path, first: float = 0.0) -> list[Corners]:
    """Corners from a CSV file (or one packed with gzip) with columns pair, corner, x, y, u1, v1, u2, v2.

    Args:
        path: the file; x and y are places on the board and name their unit (x_mm, or Xb_mm), u1, v1 are pixels in the left
            image and u2, v2 in the right one; rows where a camera did not see the corner leave its cells empty.
        first: coordinate of the middle of the first pixel in the file: 0, or 1 as in MATLAB.

    Raises:
        InputError: with everything that is wrong.
    """
    problems = Problems(f"corners {path}")
    rows = _rows(path)
    header = [name.strip() for name in rows[0][1]] if rows else []
    columns, scale = _columns(header, path, problems)
    problems.raise_if_any()
    table: dict[int, dict[str, list[float]]] = {}
    for line, row in rows[1:]:
        if not any(cell.strip() for cell in row):
            continue
        read = _row(path, line, row, columns, problems)
        if read is None:
            continue
        pair, corner, numbers = read
        if corner in table.setdefault(pair, {}):
            problems.add(path, f"corner {corner} of pair {pair} stands twice", line)
        if all(map(math.isfinite, numbers)):
            table[pair][corner] = numbers
    problems.raise_if_any()
    corners = []
    for pair, found in sorted(table.items()):
        values = np.array(list(found.values())).reshape(-1, 6)
        points = np.column_stack([values[:, :2] * scale, np.zeros(len(values))])
        corners.append(Corners(pair, points, values[:, 2:4] - first, values[:, 4:6] - first))
    return corners


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Rows with the number of their line."""
    reader = csv.reader(_lines(path))
    try:
        return [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise InputError(f"{path}:{reader.line_num}: is not a table: {error}") from None


def _lines(path: Path) -> list[str]:
    absent = "no such file of corners"
    if path.suffix != ".gz":
        return read_lines(path, absent)
    try:
        with gzip.open(path, "rb") as stream:
            content = stream.read(_LONGEST_UNPACKED + 1)
    except FileNotFoundError:
        raise InputError(f"{path}: {absent}") from None
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from None
    refuse_longer(content, path, _LONGEST_UNPACKED)
    return as_lines(content, path)


def _columns(header: list[str], path: Path, problems: Problems) -> tuple[dict[str, int], float]:
    """Where each column stands, and the factor of the lengths to m."""
    names: dict[str, int] = {}
    units = set()
    for place, name in enumerate(header):
        match = re.fullmatch(r"([xy])b?(?:_(\w+))?", name, re.IGNORECASE)
        short = match[1].lower() if match else name
        if match and match[2]:
            units.add(match[2])
        if short in names:
            problems.add(path, f"column {short} stands twice", 1)
        names[short] = place
    missing = [name for name in ("pair", "corner", *_SIX) if name not in names]
    if missing:
        problems.add(path, f"column {', '.join(missing)} is missing; expected pair,corner,x_mm,y_mm,u1,v1,u2,v2", 1)
    if len(units) != 1:
        problems.add(path, "x and y: one unit is needed for both; name the columns x_mm and y_mm", 1)
        return names, 1.0
    try:
        return names, unit_factor(units.pop(), "m")
    except InputError as error:
        problems.add(path, f"x and y: {error}", 1)
        return names, 1.0


def _row(
    path: Path, line: int, row: list[str], names: dict[str, int], problems: Problems
) -> tuple[int, str, list[float]] | None:
    columns = max(names.values()) + 1
    if len(row) != columns:
        problems.add(path, f"has {len(row)} values, the header names {columns} columns", line)
        return None
    numbers = []
    for name in _SIX:
        text = row[names[name]].strip()
        try:
            number = float(text) if text else math.nan
        except ValueError:
            problems.add(path, f"{name}: expected a number, found '{text}'", line)
            number = math.nan
        if abs(number) > _FURTHEST:
            problems.add(path, f"{name}: expected a number up to {_FURTHEST:g}, found '{text}'", line)
        numbers.append(number)
    if not all(map(math.isfinite, numbers[:2])):
        problems.add(path, "x, y: the place of the corner on the board is missing", line)
    pair = row[names["pair"]].strip()
    if not re.fullmatch(r"[0-9]{1,9}", pair, re.ASCII):
        problems.add(path, f"pair: expected a whole number, found '{pair}'", line)
        return None
    return int(pair), row[names["corner"]].strip(), numbers
