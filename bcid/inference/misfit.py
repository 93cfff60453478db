"""How well a prediction agrees with the measurement: chi-square, RMS residual, and the similarity that is climbed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.inference.seen import Seen, normals_of
from bcid.measurement import Measurement
from bcid.scene import Scene

Array = NDArray[np.float64]


class Misfit:
    """Compares predicted fiducial positions with a measurement, frame by frame.

    Every visible coordinate counts once, weighted by its standard deviation; a fiducial that was not seen is left out. Of a surface
    mark there is one, along the normal of the surface.
    When neither the measurement nor the scene states the noise, all coordinates weigh the same and `noise` is None.

    Attributes:
        noise: root mean square standard deviation of the visible coordinates, m, or None.
        values: number of visible coordinates.
        motion_rms: RMS distance of the measured positions from rest, m: what predicting no motion would miss.
        frames: number of frames.
        common: RMS of what an error of the measured frame does to a coordinate, m; it persists along all trajectories.
        curves: number of visible trajectories (action, fiducial, axis): errors of the model persist along each of them.
    """

    def __init__(self, scene: Scene, measurement: Measurement) -> None:
        columns = [scene.fiducial_names.index(name) for name in measurement.fiducial_names]
        frames = len(measurement.positions)
        self.measured = np.full((frames, len(scene.fiducials), 3), np.nan)
        self.measured[:, columns] = measurement.positions
        self._seen = Seen.of(self.measured, normals_of(scene, measurement, len(scene.fiducials)))
        self.visible = self._seen.mask
        self.frames = frames
        self._counts = self.visible.sum(axis=(1, 2))
        self.values = int(self._counts.sum())
        actions = measurement.data["action"].values.astype(str)
        self.curves = sum(int(self.visible[actions == name].any(axis=0).sum()) for name in np.unique(actions))
        sigma = measurement.sigma(scene.noise_sigma)
        self._sigma = np.ones(self.measured.shape)
        if sigma is not None:
            self._sigma[:, columns] = sigma
        self.noise = None if sigma is None else float(np.sqrt(np.mean(self._sigma[self.visible] ** 2)))
        error = measurement.frame_error
        self.common = 0.0 if error is None else error.rms(self.measured)
        self.motion_rms = float(np.sqrt(np.mean(self._seen.take(self.measured - scene.rest) ** 2)))

    def frame(self, index: int, predicted: Array) -> tuple[float, float]:
        """Chi-square and sum of squared residuals (m^2) of one frame; `predicted` has shape (fiducials, 3), or more rows."""
        seen = self.visible[index]
        residual = self._seen.take_frame(index, predicted[: len(seen)] - self.measured[index])
        scaled = residual / self._sigma[index][seen]
        return float(scaled @ scaled), float(residual @ residual)

    def rms(self, squares: float) -> float:
        """RMS residual per coordinate, m, from the sum of squares over all frames."""
        return float(np.sqrt(squares / self.values))

    def weighted_rms(self, chi2: float) -> float:
        """RMS residual per coordinate, weighted by the noise, m, from chi-square over all frames."""
        return float(np.sqrt(chi2 / self.values)) * (self.noise or 1.0)

    def distance(self, a: Array, b: Array) -> float:
        """RMS difference of two predictions (frames, fiducials or more rows, 3) over the visible coordinates, m."""
        return float(np.sqrt(np.mean(self._seen.take((a - b)[:, : self.visible.shape[1]]) ** 2)))

    def similarity(self, rms: float) -> float:
        """1 for a perfect prediction, 0 for one as bad as predicting no motion at all, negative beyond."""
        return 1.0 - rms / self.motion_rms
