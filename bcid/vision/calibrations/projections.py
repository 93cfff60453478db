"""Projection matrices and coefficients of the direct linear transformation (DLT), taken apart into cameras.

A matrix P = K [R | t] of shape (3, 4) takes homogeneous points of the world to pixels. The eleven coefficients of the DLT
(Abdel-Aziz & Karara, 1971) are its elements, row by row, divided by the twelfth. K and R follow from an RQ decomposition of the
left 3 x 3 part (Hartley & Zisserman, Multiple View Geometry, 6.2.4). The world's frame, that of the calibration object, is given
up: what remains is the place of the right camera in the frame of the left one.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems
from bcid.vision.calibrations.stored import SIDES, UPPER, Counting, Optics, Stored, numbers_of

Array = NDArray[np.float64]

# Numbers of a camera: the DLT's eleven, the same with the twelfth or a matrix, and those of the DLT with distortion.
ELEVEN, TWELVE, SIXTEEN = 11, 12, 16
_SIXTEEN = (
    "has 16 coefficients for a camera, the last five of which are a distortion in terms of distorted pixels; expected 11: "
    "undistort the images and fit 11, or calibrate with bcid calibrate --board POINTS.csv --picked PICKED.csv"
)
# Names in files of TOML, JSON and the like; {n} is 1 or 2, {s} left or right.
_NAMES = (
    "P{n}",
    "P_{s}",
    "{s}_projection",
    "projection_{s}",
    "projection_{n}",
    "dlt_{s}",
    "dlt_{n}",
    "L{n}",
    "L_{s}",
    "DLT{n}",
)
_BOTH = ("dlt", "DLT", "dltcoefs", "projections", "P", "L")
# What stands beside P1 and P2 where these are for rectified images, and beside cameras that are stated otherwise.
_RECTIFIED = ("R1", "R2", "Q", "R", "T")
# Depth of the world's origin beside its distance, below which it is that of the camera itself.
_AT_CAMERA = 1e-9


def find_projections(values: dict[str, Any]) -> list[Any] | None:
    """Two sets of coefficients or matrices that a file names; None where it names none, or only those of rectified images."""
    if any(name in values for name in _RECTIFIED):
        return None
    for pattern in _NAMES:
        pair = [values.get(pattern.format(n=n, s=side)) for n, side in enumerate(SIDES, start=1)]
        if all(one is not None for one in pair):
            return pair
    both = next((values[name] for name in _BOTH if name in values), None)
    if both is None:
        return None
    return split_pair(np.asarray(both, dtype=float)) if _numeric(both) else [both, None]


def split_pair(numbers: Array) -> list[Array]:
    """The numbers of each camera, of a table with a column or a row for each, or of matrices; others stay together."""
    shape = numbers.shape
    if numbers.ndim == 2 and (shape[0] in (ELEVEN, SIXTEEN) or (shape[0] == TWELVE and shape[1] != 4)):
        return list(numbers.T)
    if numbers.ndim == 2 and shape[0] % 3 == 0 and shape[1] == 4:
        return list(numbers.reshape(-1, 3, 4))
    if shape == (3, 8):
        return [numbers[:, :4], numbers[:, 4:]]
    known = numbers.ndim > 1 and numbers[0].size in (ELEVEN, TWELVE, SIXTEEN)
    return list(numbers) if known else [numbers]


def from_projections(
    pair: Sequence[Any], unit: Any, counting: Counting, path: Path, problems: Problems
) -> Stored | None:
    """Two cameras from their projections; None with what is wrong noted.

    Args:
        pair: for each camera 11 coefficients, or 3 x 4 numbers.
        unit: of the world's lengths, as the file states it.
    """
    if len(pair) != 2:
        shape = " x ".join(map(str, np.shape(pair[0])))
        problems.add(
            path,
            f"holds {len(pair)} camera(s) of {shape} numbers, expected two; keep the two that filmed the body, the left one "
            "first: a column of 11 coefficients for each, or two matrices of 3 x 4 one above the other",
        )
        return None
    before = len(problems.found)
    flip = counting.to_opencv(path, problems)
    size = counting.image_size(path, problems)
    matrices = [_as_matrix(numbers, side, path, problems) for numbers, side in zip(pair, SIDES, strict=True)]
    if len(problems.found) > before:
        return None
    parts = [decompose(flip @ matrix) for matrix in matrices]
    for part, side in zip(parts, SIDES, strict=True):
        if part is None:
            problems.add(
                path, f"the projection of the {side} camera is of a camera at infinity: its left 3 x 3 part is singular"
            )
    known = [part for part in parts if part is not None]
    if len(known) < 2:
        return None
    depths = [translation[2] / max(float(np.linalg.norm(translation)), 1e-300) for _, _, translation in known]
    if max(depths) < -_AT_CAMERA:
        problems.add(path, _mirrored(counting))
        return None
    (left, first, start), (right, second, end) = known
    turn = second @ first.T
    none = np.zeros(0)
    return Stored(Optics(left, none, size), Optics(right, none, size), turn, end - turn @ start, unit)


def decompose(projection: Array) -> tuple[Array, Array, Array] | None:
    """K with positive focal lengths, R and t of a matrix (3, 4) up to its scale; None for a camera at infinity.

    The sign of the scale is the one that makes R a rotation, not a reflection.
    """
    from scipy.linalg import rq

    part = projection[:, :3]
    if not np.linalg.cond(part) < 1 / np.finfo(float).eps:
        return None
    # Its scale may be any: the determinant of a small matrix would be none.
    projection = projection / np.abs(part).max()
    projection *= np.sign(np.linalg.det(projection[:, :3]))
    upper, turn = rq(projection[:, :3])
    signs = np.sign(np.diag(upper))
    upper, turn = upper * signs, signs[:, None] * turn
    translation = np.linalg.solve(upper, projection[:, 3])
    return np.triu(upper / upper[2, 2]), turn, translation


def _as_matrix(value: Any, side: str, path: Path, problems: Problems) -> Array:
    count = np.size(value) if _numeric(value) else 0
    if count == SIXTEEN:
        problems.add(path, _SIXTEEN)
        return np.eye(3, 4)
    name = f"the projection of the {side} camera (11 coefficients, or 3 x 4)"
    if count == ELEVEN:
        return np.append(numbers_of(value, (ELEVEN,), name, path, problems), 1.0).reshape(3, 4)
    return numbers_of(value, (3, 4), name, path, problems)


def _numeric(value: Any) -> bool:
    try:
        np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return False
    return True


def _mirrored(counting: Counting) -> str:
    """What to do where the cameras would look away from the calibration object."""
    other = (
        "it counts v down; leave origin away"
        if counting.origin not in (None, UPPER)
        else ('it counts v up, as older versions of DLTdv do: state origin = "lower left" and image_size')
    )
    return (
        "with positive focal lengths the origin of the world lies behind both cameras: the projections are mirrored. Either "
        f"{other} (camera_origin, camera_image_size in a recording); or the world's axes are left-handed: change the sign of the "
        "third column of both matrices (L3, L7, L11); or the origin is behind the cameras: choose one in front of them"
    )
