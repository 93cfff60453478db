"""Calibrations in MAT files: MATLAB's stereoParameters as a struct, and Calib_Results_stereo of Bouguet's toolbox.

MATLAB counts pixels from 1, multiplies row vectors from the left (x K, x R + t) in its older properties and column vectors from
the right in its newer ones (K, PoseCamera2), and has radial and tangential coefficients apart. Bouguet's toolbox counts pixels
from 0, and has OpenCV's order of coefficients.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems
from bcid.measurement.formats.array_file import look
from bcid.vision.calibrations.stored import SIDES, Optics, Stored, numbers_of, size_of

Array = NDArray[np.float64]

_SAVE = "in MATLAB, s = toStruct(stereoParams); save('stereo.mat', '-struct', 's')"
_CAMERA = "CameraParameters"
_UNITS = {
    "millimeters": "mm",
    "millimeter": "mm",
    "centimeters": "cm",
    "centimeter": "cm",
    "meters": "m",
    "meter": "m",
    "inches": "in",
    "inch": "in",
}
# Sizes of arrays, and how many of them, that a calibration may have.
_LARGEST, _MOST = 64, 500


def matlab_values(path: Path) -> dict[str, Any]:
    """Small arrays and texts of a MAT file by their paths, as ``CameraParameters1/K``; those of a struct that holds all else
    without its name.

    Raises:
        InputError: it is damaged.
    """
    shapes = look(path, []).shapes
    small = [name for name, shape in shapes.items() if np.prod(shape, dtype=float) <= _LARGEST][:_MOST]
    values = look(path, small).arrays
    outer = next((name.partition(f"{_CAMERA}1/")[0] for name in shapes if f"{_CAMERA}1/" in name), "")
    return {name.removeprefix(outer): values[name] for name in small if name in values and name.startswith(outer)}


def is_stereo_parameters(values: dict[str, Any]) -> bool:
    """Whether they are those of MATLAB's stereoParameters."""
    return any(name.startswith(f"{_CAMERA}1/") for name in values)


def is_bouguet(values: dict[str, Any]) -> bool:
    """Whether they are those of Bouguet's toolbox."""
    return "fc_left" in values or "fc_right" in values


def unknown(path: Path, values: dict[str, Any]) -> InputError:
    """That a MAT file holds no calibration, and how to save one."""
    some = ", ".join(list(values)[:8]) or "nothing that can be read"
    return InputError(
        f"{path}: not a calibration file: holds {some}; an object of MATLAB cannot be read: save it as a struct: {_SAVE}"
    )


def stereo_parameters(values: dict[str, Any], path: Path, problems: Problems) -> Stored:
    """MATLAB's stereoParameters, from its struct."""
    left, right = (_parameters(values, number, path, problems) for number in (1, 2))
    rotation, translation = _pose(values, path, problems)
    units = [str(np.ravel(values[name])[0]) for name in values if name.endswith("WorldUnits") and np.size(values[name])]
    unit = next((_UNITS.get(one.strip().lower(), one.strip()) for one in units if one.strip()), None)
    return Stored(left, right, rotation, translation, unit)


def bouguet(values: dict[str, Any], path: Path, problems: Problems) -> Stored:
    """Calib_Results_stereo.mat of Bouguet's toolbox: X_right = R X_left + T, om the rotation vector of R."""
    from scipy.spatial.transform import Rotation

    size = (0, 0)
    if "nx" in values and "ny" in values:
        size = size_of([_scalar(values["nx"]), _scalar(values["ny"])], "nx, ny", path, problems)
    cameras = []
    for side in SIDES:
        focal = numbers_of(values.get(f"fc_{side}"), (2,), f"fc_{side}", path, problems)
        middle = numbers_of(values.get(f"cc_{side}"), (2,), f"cc_{side}", path, problems)
        skew = numbers_of(values.get(f"alpha_c_{side}", 0.0), (1,), f"alpha_c_{side}", path, problems)
        lens = numbers_of(values.get(f"kc_{side}", []), None, f"kc_{side}", path, problems)
        cameras.append(Optics(_matrix(focal, middle, skew[0] * focal[0]), lens, size))
    if "R" in values or "om" not in values:
        rotation = numbers_of(values.get("R"), (3, 3), "R", path, problems)
    else:
        rotation = Rotation.from_rotvec(numbers_of(values["om"], (3,), "om", path, problems)).as_matrix()
    return Stored(cameras[0], cameras[1], rotation, numbers_of(values.get("T"), (3,), "T", path, problems))


def _parameters(values: dict[str, Any], number: int, path: Path, problems: Problems) -> Optics:
    """One of the two cameras; of its struct or of its part Intrinsics."""
    camera = f"{_CAMERA}{number}"
    own: dict[str, Any] = {}
    for name, value in values.items():
        if name.startswith(f"{camera}/"):
            own.setdefault(name.rpartition("/")[2], value)
    if not own:
        problems.add(path, f"{camera}: is missing, or an object of MATLAB; save it as a struct: {_SAVE}")
        return Optics(np.eye(3), np.zeros(0), (0, 0))
    matrix = _intrinsics(own, camera, path, problems)
    matrix[:2, 2] -= 1
    radial = numbers_of(own.get("RadialDistortion", [0, 0]), None, f"{camera}.RadialDistortion", path, problems)
    tangential = numbers_of(
        own.get("TangentialDistortion", [0, 0]), (2,), f"{camera}.TangentialDistortion", path, problems
    )
    if len(radial) not in (2, 3):
        problems.add(path, f"{camera}.RadialDistortion: expected 2 or 3 coefficients, found {len(radial)}")
        radial = np.zeros(2)
    size = np.ravel(own.get("ImageSize", []))
    stated = size_of(size[::-1], f"{camera}.ImageSize", path, problems) if len(size) else (0, 0)
    return Optics(matrix, np.concatenate([radial[:2], tangential, radial[2:]]), stated)


def _intrinsics(own: dict[str, Any], camera: str, path: Path, problems: Problems) -> Array:
    """Of the newer K, or the transpose of the older IntrinsicMatrix, or of its parts; pixels as MATLAB counts them."""
    if "K" in own:
        return numbers_of(own["K"], (3, 3), f"{camera}.K", path, problems)
    if "IntrinsicMatrix" in own or "FocalLength" not in own:
        return numbers_of(own.get("IntrinsicMatrix"), (3, 3), f"{camera}.IntrinsicMatrix", path, problems).T
    focal = numbers_of(own["FocalLength"], (2,), f"{camera}.FocalLength", path, problems)
    middle = numbers_of(own.get("PrincipalPoint"), (2,), f"{camera}.PrincipalPoint", path, problems)
    return _matrix(focal, middle, float(numbers_of(own.get("Skew", 0.0), (1,), f"{camera}.Skew", path, problems)[0]))


def _pose(values: dict[str, Any], path: Path, problems: Problems) -> tuple[Array, Array]:
    """Rotation and translation from camera 1 to camera 2, for column vectors."""
    whole = values.get("PoseCamera2", values.get("PoseCamera2/A"))
    if whole is not None and np.shape(whole) == (4, 4):
        pose = numbers_of(whole, (4, 4), "PoseCamera2", path, problems)
        return pose[:3, :3], pose[:3, 3]
    if "PoseCamera2/R" in values:
        turn = numbers_of(values["PoseCamera2/R"], (3, 3), "PoseCamera2.R", path, problems)
        return turn, numbers_of(values.get("PoseCamera2/Translation"), (3,), "PoseCamera2.Translation", path, problems)
    if "RotationOfCamera2" not in values:
        problems.add(path, f"RotationOfCamera2 (or PoseCamera2 with R and Translation): is missing; {_SAVE}")
        return np.eye(3), np.ones(3)
    turn = numbers_of(values["RotationOfCamera2"], (3, 3), "RotationOfCamera2", path, problems).T
    return turn, numbers_of(values.get("TranslationOfCamera2"), (3,), "TranslationOfCamera2", path, problems)


def _matrix(focal: Array, middle: Array, skew: float) -> Array:
    return np.array([[focal[0], skew, middle[0]], [0, focal[1], middle[1]], [0, 0, 1]])


def _scalar(value: Any) -> Any:
    return np.ravel(value)[0] if np.size(value) == 1 else value
