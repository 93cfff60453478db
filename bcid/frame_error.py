"""What is not known of the frame in which positions were measured: an error that all points and steps have in common."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Parts of the error that are this small beside its largest are none.
_LEAST = 1e-9


@dataclass(frozen=True)
class FrameError:
    """A small unknown rotation, shift and change of scale of the measured frame, with mean zero.

    Attributes:
        centre: about which it turns and grows, shape (3,), m.
        covariance: of rotation vector (rad), shift (m) and logarithm of the scale, shape (7, 7).
    """

    centre: Array
    covariance: Array

    def modes(self, points: Array) -> Array:
        """Displacements (..., 3, k), m, of points (..., 3): independent, each as large as one standard deviation of its part."""
        # Lengths are brought to the size of the body, so that angles and shifts can be compared.
        away = points - self.centre
        reach = float(np.sqrt(np.nanmean(away**2))) or 1.0
        scales = np.array([reach] * 3 + [1.0] * 3 + [reach])
        sizes, axes = np.linalg.eigh(self.covariance * np.outer(scales, scales))
        kept = sizes > _LEAST * max(sizes.max(), 1e-30)
        parts = axes[:, kept] * np.sqrt(sizes[kept]) / scales[:, None]
        return np.asarray(slopes(away) @ parts)

    def rms(self, points: Array) -> float:
        """RMS displacement per coordinate of points (..., 3), m."""
        return float(np.sqrt(np.nanmean(np.sum(self.modes(points) ** 2, axis=-1))))


def slopes(away: Array) -> Array:
    """Derivatives (..., 3, 7) of points at `away` (..., 3), m, from the centre by the seven parts of a `FrameError`."""
    x, y, z = np.moveaxis(away, -1, 0)
    slope = np.zeros((*away.shape, 7))
    slope[..., 0, 1], slope[..., 0, 2] = z, -y
    slope[..., 1, 0], slope[..., 1, 2] = -z, x
    slope[..., 2, 0], slope[..., 2, 1] = y, -x
    slope[..., :, 3:6] = np.eye(3)
    slope[..., :, 6] = away
    return slope
