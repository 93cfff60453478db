"""Matrices by name: bcid's own calibrations, OpenCV's names, and what others call the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import Problems, nearest
from bcid.vision.calibrations.stored import SIDES, Counting, Optics, Stored, numbers_of, size_of

# Names that files of OpenCV and of others use; {n} is 1 or 2, {s} left or right.
_MATRIX = ("K{n}", "M{n}", "camera_matrix_{n}", "cameraMatrix{n}", "camera_matrix_{s}", "{s}_camera_matrix", "K_{s}")
_DISTORTION = (
    "D{n}",
    "distCoeffs{n}",
    "dist_coeffs_{n}",
    "distortion_{n}",
    "distortion_{s}",
    "{s}_distortion",
    "D_{s}",
)
_ROTATION = ("R", "rotation")
_TRANSLATION = ("T", "t", "translation")
_SIZE = ("image_size", "imageSize", "size")


def own(values: dict[str, Any], path: Path, problems: Problems) -> Stored:
    """What bcid wrote."""
    cameras = []
    for side in SIDES:
        table = values.get(side)
        if not isinstance(table, dict):
            problems.add(path, f"{side}: the camera is missing")
            table = {"matrix": np.eye(3)}
        cameras.append(
            Optics(
                numbers_of(table.get("matrix"), (3, 3), f"{side}.matrix", path, problems),
                numbers_of(table.get("distortion", []), None, f"{side}.distortion", path, problems),
                size_of(table.get("size", (0, 0)), f"{side}.size", path, problems),
            )
        )
    return _stored(cameras, values, ("rotation", "translation"), path, problems)


def named(values: dict[str, Any], counting: Counting, path: Path, problems: Problems) -> Stored:
    """Matrices under the names of OpenCV and others."""
    shift = counting.to_opencv(path, problems)
    if shift[1, 1] < 0:
        problems.add(path, "origin: matrices with distortion count from the upper left; v down is what they mean")
    size = counting.image_size(path, problems)
    cameras = []
    for number, side in enumerate(SIDES, start=1):
        found = []
        for what, patterns, shape in (("matrix", _MATRIX, (3, 3)), ("distortion", _DISTORTION, None)):
            names = tuple(name.format(n=number, s=side) for name in patterns)
            value = _first(values, names)
            if value is None:
                hint = nearest(names[0], values)
                problems.add(path, f"the {what} of the {side} camera ({' or '.join(names[:3])}) is missing; {hint}")
                value = np.zeros(shape or 0)
            found.append(numbers_of(value, shape, names[0], path, problems))
        cameras.append(Optics(shift @ found[0], found[1], size))
    usual = _ROTATION, _TRANSLATION
    rotation, translation = (next((name for name in names if name in values), names[0]) for names in usual)
    return _stored(cameras, values, (rotation, translation), path, problems)


def stated_size(values: dict[str, Any]) -> Any:
    """Width and height of the images, as a file has them; None where it has not."""
    return _first(values, _SIZE)


def _stored(
    cameras: list[Optics], values: dict[str, Any], names: tuple[str, str], path: Path, problems: Problems
) -> Stored:
    """The two cameras with what the file says beside them; `names` are those of rotation and translation."""
    rotation = numbers_of(values.get(names[0]), (3, 3), names[0], path, problems)
    translation = numbers_of(values.get(names[1]), (3,), names[1], path, problems)
    error = values.get("reprojection_error")
    if error is not None:
        error = float(numbers_of(error, (1,), "reprojection_error", path, problems)[0])
    return Stored(cameras[0], cameras[1], rotation, translation, values.get("length_unit"), error)


def _first(values: dict[str, Any], names: tuple[str, ...]) -> Any:
    return next((values[name] for name in names if name in values), None)
