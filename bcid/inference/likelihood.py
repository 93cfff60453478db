"""The measured coordinates as one vector, and what is known of their error: noise, and the error of the mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.inference.mesh_error import MeshError
from bcid.measurement import Measurement
from bcid.scene import Scene

Array = NDArray[np.float64]

# How far the error of the mesh may be from what the ladder says: of each action as a whole, and of a single trajectory.
_OF_ACTION = 0.5
_OF_TRAJECTORY = 0.5
_OF_FIDUCIAL = 1.5
# Without a stated noise and with too few steps to see it, m.
_LEAST_NOISE = 1e-6


class Data:
    """Every visible coordinate of a measurement, in one vector, with the labels needed to group them.

    Args:
        scene: the scene.
        measurement: must fit the scene.

    Attributes:
        mask: which of (frames, fiducials, 3) were seen.
        values: measured positions, shape (n,), m.
        sigma: standard deviation of each, m; NaN when none is stated.
        action, frame, step, fiducial, axis: labels, shape (n,); actions and fiducials as numbers.
        trajectory: number of the (action, fiducial, axis) it belongs to, shape (n,).
        progress: part of its action that is done, 0 at step 0 and 1 at the last step seen, shape (n,).
    """

    def __init__(self, scene: Scene, measurement: Measurement) -> None:
        columns = [scene.fiducial_names.index(name) for name in measurement.fiducial_names]
        shape = (len(measurement.positions), len(scene.fiducials), 3)
        measured, sigma = np.full(shape, np.nan), np.full(shape, np.nan)
        measured[:, columns] = measurement.positions
        stated = measurement.sigma(scene.noise_sigma)
        if stated is not None:
            sigma[:, columns] = stated
        self.scene, self.measurement = scene, measurement
        self.measured = measured
        self.mask = np.isfinite(measured)
        self.values, self.sigma = measured[self.mask], sigma[self.mask]
        self.stated = stated is not None
        frames, fiducials, axes = np.nonzero(self.mask)
        names = measurement.action_names
        actions = np.array([names.index(str(name)) for name in measurement.data["action"].values])
        self.frame, self.fiducial, self.axis = frames, fiducials, axes
        self.action, self.step = actions[frames], measurement.data["step"].values[frames]
        key = (self.action * len(scene.fiducials) + fiducials) * 3 + axes
        _, self.trajectory = np.unique(key, return_inverse=True)
        self.actions = names
        last = np.array([self.step[self.action == a].max(initial=1) for a in range(len(names))])
        self.progress = self.step / last[self.action]

    def __len__(self) -> int:
        return len(self.values)

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
        return np.full(len(self), max(estimate_noise(self, residual), _LEAST_NOISE))


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


class Errors:
    """Covariance of the residual: white noise, the error of the mesh as far as the ladder tells, and that of the measured frame.

    The error that is left after extrapolation has the shape of the extrapolation with an uncertain factor per action, and
    beside it parts that persist along every trajectory (a constant and a slope along the steps) and that each fiducial has
    in common in all actions.

    Args:
        data: the measured values.
        sigma: standard deviation of the noise, shape (n,), m.
        mesh: what the ladder says.
    """

    def __init__(self, data: Data, sigma: Array, mesh: MeshError) -> None:
        self.data, self.sigma, self.mesh = data, sigma, mesh
        columns = np.column_stack([self._columns(data.vector(mesh.left)), self._of_frame()])
        if columns.shape[1] == 0:
            self._basis: Array = np.zeros((len(data), 0))
            self._shrink: Array = np.zeros(0)
            return
        basis, sizes, _ = np.linalg.svd(columns / sigma[:, None], full_matrices=False)
        self._basis = basis[:, sizes > 1e-6]
        self._shrink = 1 - 1 / np.sqrt(1 + sizes[sizes > 1e-6] ** 2)

    def _columns(self, left: Array) -> Array:
        data, columns = self.data, []
        for action in range(len(data.actions)):
            here = data.action == action
            if np.any(left[here]):
                columns.append(np.where(here, _OF_ACTION * left, 0.0))
        if columns:
            size = {a: float(np.sqrt(np.mean(left[data.action == a] ** 2))) for a in np.unique(data.action)}
            for number in range(int(data.trajectory.max()) + 1):
                members = np.flatnonzero(data.trajectory == number)
                own = np.sqrt(np.mean(left[members] ** 2))
                amount = _OF_TRAJECTORY * max(own, size[data.action[members[0]]])
                shape = np.zeros((len(data), 2))
                # At rest there is no error; it grows with the motion.
                along = np.linspace(0.0, 1.0, len(members)) if len(members) > 1 else np.ones(1)
                shape[members, 0] = amount * np.minimum(1.0, 4 * along)
                shape[members, 1] = amount * (2 * along - 1) * np.minimum(1.0, 4 * along)
                columns += [shape[:, 0], shape[:, 1]]
            common = np.sqrt(np.mean(left**2)) * _OF_FIDUCIAL
            for fiducial, axis in np.unique(np.column_stack([data.fiducial, data.axis]), axis=0):
                here = (data.fiducial == fiducial) & (data.axis == axis)
                columns.append(np.where(here, common * data.progress, 0.0))
        return np.array(columns).T if columns else np.zeros((len(data), 0))

    def _of_frame(self) -> Array:
        """What an error of the measured frame does to all values together."""
        error = self.data.measurement.frame_error
        if error is None:
            return np.zeros((len(self.data), 0))
        return np.asarray(error.modes(self.data.measured)[self.data.mask])

    def whiten(self, values: Array) -> Array:
        """Values (n,) or columns (n, m), m, in units in which their errors are independent and of size one."""
        scaled = values / (self.sigma if values.ndim == 1 else self.sigma[:, None])
        if not len(self._shrink):
            return np.asarray(scaled)
        shrink = self._shrink if values.ndim == 1 else self._shrink[:, None]
        return np.asarray(scaled - self._basis @ (shrink * (self._basis.T @ scaled)))

    @property
    def log_volume(self) -> float:
        """Half the logarithm of the determinant of the covariance, of it in m."""
        return float(np.sum(np.log(self.sigma)) - np.sum(np.log1p(-self._shrink)))

    def unwhiten(self, values: Array) -> Array:
        """The inverse of `whiten` for values (n,): back to m."""
        grow = self._shrink / (1 - self._shrink)
        return np.asarray((values + self._basis @ (grow * (self._basis.T @ values))) * self.sigma)
