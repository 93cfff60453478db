"""Two calibrated cameras: projection with lens distortion, undistortion, and the files that hold them.

Pixel coordinates are (u, v): u to the right, v down, and the middle of the upper left pixel is at (0, 0). A camera looks
along its z axis, with x to the right and y down. Lens distortion is OpenCV's (k1, k2, p1, p2, k3, ...).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems, nearest, unwritable
from bcid.base.text_file import parse_json, parse_toml, read_text
from bcid.base.units import FURTHEST, MOST, unit_factor
from bcid.measurement.frame_error import plain_numbers

Array = NDArray[np.float64]

FORMAT = "bcid-cameras/1"
SIDES = ("left", "right")
# Numbers of coefficients that OpenCV's model of a lens may have.
_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
# Undistortion: steps at most, and the accuracy of the direction.
_STEPS, _EXACT = 200, 1e-14
# A lens whose distortion cannot be undone leaves more than this, pixels.
_UNDONE = 1e-6
# No image is wider, px.
_WIDEST = 1_000_000
# Names that files of OpenCV and of others use; {side} is 1 or 2.
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


@dataclass(frozen=True)
class Camera:
    """One camera.

    Attributes:
        matrix: focal lengths and principal point as OpenCV's camera matrix, shape (3, 3), px.
        distortion: coefficients of the lens, shape (0), (4), (5), (8), (12) or (14).
        size: width and height of its images, px; (0, 0) when not known.
    """

    matrix: Array
    distortion: Array
    size: tuple[int, int] = (0, 0)

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of points (n, 3) in the camera's frame, m; NaN for points that are not in front of it."""
        import cv2

        points = np.asarray(points, dtype=float).reshape(-1, 3)
        seen = points[:, 2] > 0
        pixels = np.full((len(points), 2), np.nan)
        if seen.any():
            # Directions only: OpenCV would take the unit of length into account nowhere else.
            rays = points[seen] / points[seen, 2:]
            still = np.zeros(3)
            pixels[seen] = cv2.projectPoints(rays, still, still, self.matrix, self._lens())[0].reshape(-1, 2)
        return pixels

    def undistort(self, pixels: Array) -> Array:
        """Directions (n, 2), x/z and y/z, of what is seen at pixels (n, 2).

        The distortion is undone to the last digit where it can be undone at all; elsewhere (far outside of the image) the
        result is NaN.
        """
        import cv2

        pixels = np.asarray(pixels, dtype=float).reshape(-1, 2)
        rays = self.pinhole(pixels)
        if not np.any(self.distortion) or len(rays) == 0:
            return rays
        # On directions, so that a skew of the axes counts too.
        ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _STEPS, _EXACT)
        found = cv2.undistortPoints(rays[:, None], np.eye(3), self._lens(), criteria=ends).reshape(-1, 2)
        left = np.linalg.norm(self._distorted(found) - rays, axis=1) * self.focal
        return np.where((left < _UNDONE)[:, None], found, np.nan)

    def pinhole(self, pixels: Array) -> Array:
        """Directions (n, 2) of pixels (n, 2) if the lens did not distort."""
        homogeneous = np.column_stack([pixels, np.ones(len(pixels))])
        return np.asarray(np.linalg.solve(self.matrix, homogeneous.T).T[:, :2])

    @property
    def focal(self) -> float:
        """Mean focal length, px."""
        return float(np.mean([self.matrix[0, 0], self.matrix[1, 1]]))

    def _distorted(self, rays: Array) -> Array:
        import cv2

        points = np.column_stack([rays, np.ones(len(rays))])
        return np.asarray(
            cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), self._lens())[0].reshape(-1, 2)
        )

    def _lens(self) -> Array | None:
        return self.distortion if len(self.distortion) else None


@dataclass(frozen=True)
class Cameras:
    """Two cameras that see the same body: a point at x in the frame of the left one is at rotation x + translation in the right's.

    Attributes:
        rotation, translation: shapes (3, 3) and (3,), m.
        error: RMS reprojection error of the calibration, px; None when not known.
    """

    left: Camera
    right: Camera
    rotation: Array
    translation: Array
    error: float | None = None

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixels (n, 2) in the left and in the right image of points (n, 3) in the left camera's frame, m."""
        return self.left.project(points), self.right.project(points @ self.rotation.T + self.translation)

    @property
    def baseline(self) -> float:
        """Distance between the cameras, m."""
        return float(np.linalg.norm(self.translation))

    @property
    def angle(self) -> float:
        """Angle between the two optical axes, deg."""
        return math.degrees(math.acos(float(np.clip(self.rotation[2, 2], -1, 1))))

    @classmethod
    def read(cls, path: str | Path, length_unit: str | None = None) -> Cameras:
        """Read a calibration: bcid's own (JSON), OpenCV's storage (YAML, XML, JSON), or plain matrices in TOML or JSON.

        A file that is not bcid's names the matrices in one of the usual ways: K1 (or M1, cameraMatrix1, camera_matrix_left),
        D1 (or distCoeffs1, distortion_left), the same with 2 or right, R, T, and optionally image_size.

        Args:
            path: the file.
            length_unit: of the translation; files of bcid state it themselves, in others `length_unit` may stand.

        Raises:
            InputError: with everything that is wrong.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"{path}: no such calibration file")
        values = _values(path)
        problems = Problems(f"calibration {path}")
        found = _own(values, path, problems) if values.get("format") == FORMAT else _foreign(values, path, problems)
        unit = values.get("length_unit", length_unit)
        if not isinstance(unit, str):
            problems.add(path, 'length_unit: of the translation is not stated; give it, as "mm"')
        error = values.get("reprojection_error")
        if error is not None:
            error = float(_array(error, (1,), "reprojection_error", path, problems)[0])
        try:
            scale = unit_factor(str(unit), "m")
        except InputError as wrong:
            problems.add(path, f"length_unit: {wrong}")
        problems.raise_if_any()
        left, right = (
            Camera(found[f"{side}.matrix"], found[f"{side}.distortion"], found[f"{side}.size"]) for side in SIDES
        )
        cameras = cls(left, right, found["rotation"], found["translation"] * scale, error)
        cameras._check(path, problems)
        problems.raise_if_any()
        return cameras

    def write(self, path: str | Path) -> None:
        """Write bcid's own format (JSON, lengths in m)."""
        sides = {
            side: {"matrix": c.matrix.tolist(), "distortion": c.distortion.tolist(), "size": list(c.size)}
            for side, c in zip(SIDES, (self.left, self.right), strict=True)
        }
        content: dict[str, Any] = {"format": FORMAT, "length_unit": "m", **sides, "rotation": self.rotation.tolist()}
        content |= {"translation": self.translation.tolist(), "reprojection_error": self.error}
        path = Path(path)
        partial = path.with_name(f".{path.name}.partial")
        try:
            partial.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
            partial.replace(path)
        except OSError as error:
            raise unwritable(path, error) from None

    def _check(self, path: Path, problems: Problems) -> None:
        for side, camera in zip(SIDES, (self.left, self.right), strict=True):
            matrix = camera.matrix
            if (
                min(matrix[0, 0], matrix[1, 1]) <= 0
                or np.abs(matrix[[1, 2, 2], [0, 0, 1]]).max() > 1e-9
                or matrix[2, 2] != 1
            ):
                problems.add(path, f"the matrix of the {side} camera is not of the form fx 0 cx, 0 fy cy, 0 0 1")
            if len(camera.distortion) not in _COEFFICIENTS:
                allowed = ", ".join(map(str, _COEFFICIENTS))
                problems.add(
                    path,
                    f"the {side} camera has {len(camera.distortion)} coefficients of distortion; allowed: {allowed}",
                )
        if np.abs(self.rotation @ self.rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(self.rotation) < 0:
            problems.add(path, "the rotation between the cameras is not a rotation matrix")
        if self.baseline > FURTHEST:
            problems.add(path, f"the cameras are {self.baseline:g} m apart; is length_unit right?")
        if self.baseline == 0:
            problems.add(path, "the translation between the cameras is zero: one camera cannot measure a depth")


def _values(path: Path) -> dict[str, Any]:
    """What a calibration file holds, by name."""
    text = read_text(path)
    values: Any = None
    try:
        if path.suffix == ".toml":
            values = parse_toml(text, path)
        elif path.suffix == ".json" and "opencv-matrix" not in text:
            values = parse_json(text, path)
        else:
            values = _storage(path, text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a calibration file: {error}") from None
    if not isinstance(values, dict):
        raise InputError(f"{path}: not a calibration file: expected names with matrices")
    return values


def _storage(path: Path, text: str) -> dict[str, Any]:
    """The content of a file that OpenCV's FileStorage wrote: its text is handed over, so that no other file is opened."""
    import cv2

    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        return {name: _node(root.getNode(name)) for name in root.keys()}  # noqa: SIM118 (a FileNode is no dict)
    except (cv2.error, SystemError) as error:
        raise InputError(f"{path}: OpenCV cannot read it: {str(error).splitlines()[0]}") from None


def _node(node: Any) -> Any:
    if node.isInt() or node.isReal():
        return node.real()
    if node.isString():
        return node.string()
    if node.isSeq():
        return [_node(node.at(i)) for i in range(node.size())]
    return node.mat()


def _own(values: dict[str, Any], path: Path, problems: Problems) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for side in SIDES:
        table = values.get(side)
        if not isinstance(table, dict):
            problems.add(path, f"{side}: the camera is missing")
            continue
        found[f"{side}.matrix"] = _array(table.get("matrix"), (3, 3), f"{side}.matrix", path, problems)
        found[f"{side}.distortion"] = _array(table.get("distortion", []), None, f"{side}.distortion", path, problems)
        found[f"{side}.size"] = _size(table.get("size", (0, 0)), f"{side}.size", path, problems)
    found["rotation"] = _array(values.get("rotation"), (3, 3), "rotation", path, problems)
    found["translation"] = _array(values.get("translation"), (3,), "translation", path, problems)
    return found


def _foreign(values: dict[str, Any], path: Path, problems: Problems) -> dict[str, Any]:
    found: dict[str, Any] = {}
    size = _size(_named(values, _SIZE, (0, 0)), "image_size", path, problems)
    for number, side in enumerate(SIDES, start=1):
        wanted: tuple[tuple[str, tuple[str, ...], tuple[int, ...] | None], ...]
        wanted = (("matrix", _MATRIX, (3, 3)), ("distortion", _DISTORTION, None))
        for what, patterns, shape in wanted:
            names = tuple(name.format(n=number, s=side) for name in patterns)
            value = _named(values, names, None)
            if value is None:
                hint = nearest(names[0], values)
                problems.add(path, f"the {what} of the {side} camera ({' or '.join(names[:3])}) is missing; {hint}")
            else:
                found[f"{side}.{what}"] = _array(value, shape, names[0], path, problems)
        found[f"{side}.size"] = size
    found["rotation"] = _array(_named(values, _ROTATION, None), (3, 3), _ROTATION[0], path, problems)
    found["translation"] = _array(_named(values, _TRANSLATION, None), (3,), _TRANSLATION[0], path, problems)
    return found


def _named(values: dict[str, Any], names: tuple[str, ...], default: Any) -> Any:
    return next((values[name] for name in names if name in values), default)


def _array(value: Any, shape: tuple[int, ...] | None, name: str, path: Path, problems: Problems) -> Array:
    """Numbers of a shape (any length if None)."""
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


def _size(value: Any, name: str, path: Path, problems: Problems) -> tuple[int, int]:
    size = _array(value, (2,), name, path, problems)
    if not ((size >= 0) & (size <= _WIDEST)).all():
        problems.add(path, f"{name}: expected width and height up to {_WIDEST} px, found {str(value)[:60]!r}")
        return 0, 0
    return int(size[0]), int(size[1])
