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

from bcid.base.errors import InputError, Problems
from bcid.base.run_folder import write_whole
from bcid.base.units import FURTHEST, unit_factor
from bcid.vision.calibrations.camera_file import FORMAT, read_stored
from bcid.vision.calibrations.stored import SIDES, Counting, Optics

__all__ = ["SIDES", "Camera", "Cameras"]

Array = NDArray[np.float64]

# Numbers of coefficients that OpenCV's model of a lens may have.
_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
# Undistortion: steps at most, and the accuracy of the direction.
_STEPS, _EXACT = 200, 1e-14
# A lens whose distortion cannot be undone leaves more than this, pixels.
_UNDONE = 1e-6


@dataclass(frozen=True)
class Camera:
    """One camera.

    Attributes:
        matrix: focal lengths, principal point and skew (at [0, 1]) as a camera matrix, shape (3, 3), px.
        distortion: coefficients of the lens, shape (0), (4), (5), (8), (12) or (14).
        size: width and height of its images, px; (0, 0) when not known.
    """

    matrix: Array
    distortion: Array
    size: tuple[int, int] = (0, 0)

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of points (n, 3) in the camera's frame, m; NaN for points that are not in front of it."""
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        seen = points[:, 2] > 0
        pixels = np.full((len(points), 2), np.nan)
        if seen.any():
            # OpenCV's own projection knows no skew: it distorts directions here, and the whole matrix makes them pixels.
            rays = self._distorted(points[seen, :2] / points[seen, 2:])
            pixels[seen] = rays @ self.matrix[:2, :2].T + self.matrix[:2, 2]
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
    def read(
        cls,
        path: str | Path,
        length_unit: str | None = None,
        *,
        image_size: Any = None,
        first_pixel: Any = None,
        origin: Any = None,
    ) -> Cameras:
        """Read a calibration: bcid's own, OpenCV's storage, MATLAB's, Bouguet's, DLT coefficients, projections, plain matrices.

        docs/vision.md has the table of what is read and how it counts. The frame is that of the left camera, whatever the file's
        world is.

        Args:
            path: the file.
            length_unit: of the translation; for files that do not state it.
            image_size: width and height, px, for files that do not state it.
            first_pixel: coordinate of the middle of the first pixel, 0 or 1, of files that do not state it (0).
            origin: of their pixels, "upper left" or "lower left".

        Raises:
            InputError: with everything that is wrong.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"{path}: no such calibration file")
        problems = Problems(f"calibration {path}")
        counting = Counting(first_pixel, origin, image_size)
        size = counting.image_size(path, problems)
        found = read_stored(path, counting, problems)
        scale = _scale(None if found is None else found.length_unit, length_unit, path, problems)
        problems.raise_if_any()
        assert found is not None
        left, right = (_camera(one, size, path, problems) for one in (found.left, found.right))
        cameras = cls(left, right, found.rotation, found.translation * scale, found.error)
        cameras._check(path, problems)
        problems.raise_if_any()
        return cameras

    def write(self, path: str | Path) -> None:
        """Write bcid's own format (JSON, lengths in m).

        Raises:
            MachineError: it cannot be written.
        """
        sides = {
            side: {"matrix": c.matrix.tolist(), "distortion": c.distortion.tolist(), "size": list(c.size)}
            for side, c in zip(SIDES, (self.left, self.right), strict=True)
        }
        content: dict[str, Any] = {"format": FORMAT, "length_unit": "m", **sides, "rotation": self.rotation.tolist()}
        content |= {"translation": self.translation.tolist(), "reprojection_error": self.error}
        write_whole(Path(path), json.dumps(content, indent=1) + "\n")

    def _check(self, path: Path, problems: Problems) -> None:
        for side, camera in zip(SIDES, (self.left, self.right), strict=True):
            matrix = camera.matrix
            if (
                min(matrix[0, 0], matrix[1, 1]) <= 0
                or np.abs(matrix[[1, 2, 2], [0, 0, 1]]).max() > 1e-9
                or matrix[2, 2] != 1
            ):
                problems.add(path, f"the matrix of the {side} camera is not of the form fx s cx, 0 fy cy, 0 0 1")
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


def _camera(stored: Optics, size: tuple[int, int], path: Path, problems: Problems) -> Camera:
    """A camera of a file; its size is the one that is stated where the file has none."""
    if any(stored.size) and any(size) and stored.size != size:
        problems.add(path, f"image_size: the file says {stored.size}, elsewhere {size} is stated; leave that away")
    return Camera(stored.matrix, stored.distortion, stored.size if any(stored.size) else size)


def _scale(own: Any, stated: Any, path: Path, problems: Problems) -> float:
    """The unit of lengths, m, as the file states it or as is stated beside it."""
    factors = []
    for unit in (own, stated):
        if unit is None:
            continue
        try:
            factors.append(unit_factor(str(unit), "m"))
        except InputError as wrong:
            problems.add(path, f"length_unit: {wrong}")
            return 1.0
    if not factors:
        problems.add(path, 'length_unit: of the translation is not stated; give it, as "mm"')
        return 1.0
    if len(factors) == 2 and factors[0] != factors[1]:
        problems.add(
            path,
            f"length_unit: the file says {own!r}, elsewhere {stated!r} is stated; leave that away, or correct the file",
        )
    return factors[0]
