"""What images of two cameras showed of a board or of a calibration object: what a calibration starts from."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bcid.base.errors import InputError, Problems
from bcid.base.progress import Progress
from bcid.vision.adjustment import Size
from bcid.vision.board import CHESSBOARD, Board
from bcid.vision.calibrate import FEWEST
from bcid.vision.camera import SIDES
from bcid.vision.corners import Corners, find_corners
from bcid.vision.images import Images
from bcid.vision.known_points import KnownPoints


@dataclass(frozen=True)
class BoardViews:
    """Corners, or points, of the pairs of images.

    Attributes:
        corners: of the pairs that show the board.
        sizes: width and height of the left and of the right images, px.
        missing: why other pairs do not show it, by number.
        about: where all this is from, for the reader.
    """

    corners: list[Corners]
    sizes: tuple[Size, Size]
    missing: dict[int, str]
    about: dict[str, str]


def is_file_of_points(board: str) -> bool:
    """Whether a board is given as a file with points, not as a pattern."""
    return board.lower().endswith((".csv", ".txt"))


def board_in_images(left: Path, right: Path, board: str, progress: Progress) -> BoardViews:
    """Look for the corners of a board; see `Images.open` and `Board.parse`.

    Raises:
        InputError: images or board cannot be used, or hardly any pair shows it.
    """
    pattern = Board.parse(board)
    images = _opened(left, right)
    try:
        if not set(images[0].numbers) & set(images[1].numbers):
            raise InputError(
                f"{left} and {right}: no image has the same number in both ({_some(images[0].numbers)} and "
                f"{_some(images[1].numbers)}); the two images of a pair need the same number"
            )
        corners, missing = find_corners(*images, pattern, progress)
    finally:
        for one in images:
            one.close()
    if len(corners) < FEWEST:
        raise InputError(_too_few(len(corners), pattern, missing))
    about = {"left": str(left), "right": str(right), "board": str(pattern)}
    return BoardViews(corners, (images[0].size, images[1].size), missing, about)


def picked_points(
    board: str, picked: Path, left: Path | None, right: Path | None, image_size: str | None, first: float
) -> BoardViews:
    """Points of a calibration object that were picked in images; these only tell their size, where that is not stated.

    Args:
        board: file of the known points, see `KnownPoints.read`.
        picked: file of the pixels, see `KnownPoints.picked`.
        left, right: folders of images, or videos.
        image_size: of both images, as "1280x1024", px.
        first: coordinate of the middle of the first pixel in `picked`.

    Raises:
        InputError: with what is wrong in a file.
    """
    if image_size is not None:
        sizes = (_size(image_size),) * 2
    elif left is not None and right is not None:
        images = _opened(left, right)
        for one in images:
            one.close()
        sizes = (images[0].size, images[1].size)
    else:
        raise InputError("the size of the images is not known: give both folders of images, or --image-size 1280x1024")
    corners = KnownPoints.read(Path(board)).picked(picked, first)
    return BoardViews(corners, sizes, {}, {"picked": str(picked), "board": board})


def _size(text: str) -> Size:
    match = re.fullmatch(r"([0-9]{1,6})[xX×]([0-9]{1,6})", text)
    if not match:
        raise InputError(f"--image-size '{text}': expected width x height in pixels, as 1280x1024")
    return int(match[1]), int(match[2])


def _opened(left: Path, right: Path) -> tuple[Images, Images]:
    """Images of both cameras; all that is wrong is told at once."""
    problems = Problems("images of the two cameras")
    found = []
    for side, path in zip(SIDES, (left, right), strict=True):
        try:
            found.append(Images.open(path))
        except InputError as error:
            problems.add(side, str(error))
    problems.raise_if_any()
    return found[0], found[1]


def _some(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers[:6])) + (", ..." if len(numbers) > 6 else "")


def _too_few(count: int, board: Board, missing: dict[int, str]) -> str:
    """What to say when hardly any pair shows the board, with the reasons of the first twenty."""
    counted = "inner corners" if board.kind == CHESSBOARD else "squares"
    lines = [
        f"{count} pair(s) show the {board} in both images, at least {FEWEST} are needed; "
        f"does it have {board.columns} x {board.rows} {counted}?"
    ]
    lines += [f"  pair {number}: {reason}" for number, reason in list(missing.items())[:20]]
    if len(missing) > 20:
        lines.append(f"  ... and {len(missing) - 20} more")
    return "\n".join(lines)
