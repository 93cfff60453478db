"""What a calibration file holds once its conventions are undone: numbers of two cameras, and what was wrong with them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems
from bcid.base.units import MOST
from bcid.measurement.frame_error import plain_numbers

Array = NDArray[np.float64]

SIDES = ("left", "right")
# No image is wider, px.
_WIDEST = 1_000_000
# Where pixels are counted from: v down or v up.
UPPER, LOWER = "upper left", "lower left"


@dataclass(frozen=True)
class Optics:
    """One camera as OpenCV counts: the middle of the upper left pixel at (0, 0), v down, k1 k2 p1 p2 k3 ...

    Attributes:
        matrix: shape (3, 3), px, with the skew of its axes at [0, 1].
        distortion: coefficients of the lens.
        size: width and height of its images, px; (0, 0) when not known.
    """

    matrix: Array
    distortion: Array
    size: tuple[int, int]


@dataclass(frozen=True)
class Stored:
    """Two cameras as a file states them.

    Attributes:
        left, right: what each is.
        rotation, translation: from the left to the right camera, shapes (3, 3) and (3,), in `length_unit`.
        length_unit: as the file states it; None where it does not.
        error: RMS reprojection error, px; None when not known.
    """

    left: Optics
    right: Optics
    rotation: Array
    translation: Array
    length_unit: Any = None
    error: float | None = None


@dataclass(frozen=True)
class Counting:
    """How pixels are counted in a file, and how large its images are; None for what is not said.

    Attributes:
        first: coordinate of the middle of the first pixel: 0, or 1 as in MATLAB.
        origin: "upper left", where v counts down, or "lower left", where it counts up.
        size: width and height of the images, px.
    """

    first: Any = None
    origin: Any = None
    size: Any = None

    def joined(self, other: Counting, path: Path, problems: Problems) -> Counting:
        """What either says; a contradiction is noted."""
        pairs = {name: (getattr(self, name), getattr(other, name)) for name in ("first", "origin", "size")}
        for name, (own, stated) in pairs.items():
            if own is not None and stated is not None and own != stated:
                key = {"first": "first_pixel", "origin": "origin", "size": "image_size"}[name]
                problems.add(path, f"{key}: the file says {own!r}, elsewhere {stated!r} is stated; leave one away")
        return Counting(**{name: stated if own is None else own for name, (own, stated) in pairs.items()})

    def to_opencv(self, path: Path, problems: Problems) -> Array:
        """The matrix (3, 3) that takes homogeneous pixels of the file to those of OpenCV."""
        first = 0 if self.first is None else self.first
        if isinstance(first, bool) or first not in (0, 1):
            problems.add(path, f"first_pixel: expected 0, or 1 as in MATLAB, found {first!r}")
            return np.eye(3)
        if self.origin not in (None, UPPER, LOWER):
            problems.add(path, f'origin: expected "{UPPER}" or "{LOWER}", found {self.origin!r}')
            return np.eye(3)
        if self.origin != LOWER:
            return np.array([[1, 0, -first], [0, 1, -first], [0, 0, 1.0]])
        height = self.image_size(path, problems)[1]
        if not height:
            problems.add(
                path, f"image_size: pixels counted from the {LOWER} need it; give it, as [1280, 1024], width first"
            )
        return np.array([[1, 0, -first], [0, -1, height - 1 + first], [0, 0, 1.0]])

    def image_size(self, path: Path, problems: Problems) -> tuple[int, int]:
        """Width and height, px; zeros when not known."""
        return (0, 0) if self.size is None else size_of(self.size, "image_size", path, problems)


def numbers_of(value: Any, shape: tuple[int, ...] | None, name: str, path: Path, problems: Problems) -> Array:
    """Numbers of a shape (any length if None); what is not is noted, and zeros are given."""
    wanted = "a list of numbers" if shape is None else " x ".join(map(str, shape)) + " numbers"
    try:
        array = plain_numbers(value)
    except (TypeError, ValueError):
        array = np.array(math.nan)
    if shape is None:
        array = array.ravel()
    elif array.size == math.prod(shape):
        array = array.reshape(shape)
    if not (np.abs(array) <= MOST).all() or (shape is not None and array.shape != shape):
        found = "is missing" if value is None else f"found {str(value)[:60]!r}"
        problems.add(path, f"{name}: expected {wanted}, {found}")
        return np.zeros(shape or (0,))
    return array


def size_of(value: Any, name: str, path: Path, problems: Problems) -> tuple[int, int]:
    """Width and height of images, px."""
    size = numbers_of(value, (2,), name, path, problems)
    if not ((size >= 0) & (size <= _WIDEST)).all():
        problems.add(path, f"{name}: expected width and height up to {_WIDEST} px, found {str(value)[:60]!r}")
        return 0, 0
    return int(size[0]), int(size[1])
