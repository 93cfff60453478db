"""The measured coordinates as one vector, with what is known of their noise."""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import NDArray

from bcid.measurement import Measurement
from bcid.scene import Scene

Array = NDArray[np.float64]
# Without a stated noise and with too few steps to see it, m.
LEAST_NOISE = 1e-6


class Data:
    """Every visible coordinate of a measurement, in one vector, with the labels needed to group them.

    Args:
        scene: the scene.
        measurement: must fit the scene.
        done: part of its action's motion that is done in each frame, shape (frames,), where it does not grow with the steps.

    Attributes:
        mask: which of (frames, fiducials, 3) were seen.
        about: measured positions (frames, fiducials, 3), m, and the place at rest where nothing was seen.
        values: measured positions, shape (n,), m.
        sigma: standard deviation of each, m; NaN when none is stated.
        action, frame, step, fiducial, axis: labels, shape (n,); actions and fiducials as numbers.
        trajectory: number of the (action, fiducial, axis) it belongs to, shape (n,).
        progress: part of its action that is done, shape (n,): 0 at step 0 and, unless it is given, 1 at the last step seen.
    """

    def __init__(self, scene: Scene, measurement: Measurement, done: Array | None = None) -> None:
        columns = [scene.fiducial_names.index(name) for name in measurement.fiducial_names]
        shape = (len(measurement.positions), len(scene.fiducials), 3)
        self.measured, self._sigma = np.full(shape, np.nan), np.full(shape, np.nan)
        self.measured[:, columns] = measurement.positions
        stated = measurement.sigma(scene.noise_sigma)
        if stated is not None:
            self._sigma[:, columns] = stated
        self.scene, self.measurement, self._done = scene, measurement, done
        self.stated = stated is not None
        self.about = np.where(np.isfinite(self.measured), self.measured, scene.rest)
        self._take(np.isfinite(self.measured))

    def _take(self, mask: NDArray[np.bool_]) -> None:
        scene, measurement = self.scene, self.measurement
        self.mask: NDArray[np.bool_] = mask
        self.values, self.sigma = self.measured[mask], self._sigma[mask]
        frames, fiducials, axes = np.nonzero(self.mask)
        names = measurement.action_names
        actions = np.array([names.index(str(name)) for name in measurement.data["action"].values])
        self.frame, self.fiducial, self.axis = frames, fiducials, axes
        self.action, self.step = actions[frames], measurement.data["step"].values[frames]
        key = (self.action * len(scene.fiducials) + fiducials) * 3 + axes
        _, self.trajectory = np.unique(key, return_inverse=True)
        self.actions = names
        if self._done is not None:
            self.progress = self._done[frames]
            return
        last = np.array([self.step[self.action == a].max(initial=1) for a in range(len(names))])
        self.progress = self.step / last[self.action]

    def __len__(self) -> int:
        return len(self.values)

    def within(self, frames: NDArray[np.bool_]) -> Data:
        """The values of some frames, (frames,), alone."""
        other = copy(self)
        other._take(self.mask & frames[:, None, None])
        return other

    def vector(self, positions: Array) -> Array:
        """The visible coordinates of positions (frames, fiducials, 3), shape (n,)."""
        return np.asarray(positions[self.mask])

    def spread(self, vector: Array) -> Array:
        """A vector of values back in shape (frames, fiducials, 3), NaN where nothing was seen."""
        result = np.full(self.mask.shape, np.nan)
        result[self.mask] = vector
        return result

    def noise(self, residual: Array) -> Array:
        """Standard deviation of every value, m; estimated from the residual (m) when none is stated."""
        if self.stated:
            return self.sigma
        return np.full(len(self), max(estimate_noise(self, residual), LEAST_NOISE))


def estimate_noise(data: Data, residual: Array) -> float:
    """White noise in a residual, m, from its second differences along each trajectory: what is smooth drops out.

    Without three steps in a row the RMS of the residual stands for it.
    """
    found = []
    for number in range(int(data.trajectory.max()) + 1):
        values = residual[data.trajectory == number]
        if len(values) > 2:
            found.append(np.diff(values, 2) / np.sqrt(6))
    if not found:
        return float(np.sqrt(np.mean(residual**2)))
    return float(np.sqrt(np.mean(np.concatenate(found) ** 2)))
