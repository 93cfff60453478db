"""The one likelihood: how far measured positions may be from predicted ones, and how likely that is.

Seen = predicted + error of the mesh + what the scene has slightly wrong + error of the measured frame + noise. All are
Gaussian, so that the covariance is a diagonal (the noise) and parts of low rank: some of single fiducials, the others
common to all. Whitening by it, its determinant and its inverse cost no more than linearly in the number of values.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.base.tails import normal_tail
from bcid.inference import response
from bcid.inference.data import Data
from bcid.inference.evidence import LowRankDiscrepancy
from bcid.inference.mesh_error import MeshError
from bcid.inference.nuisances import MARKERS, STIFFNESS, NuisanceModes
from bcid.inference.priors import PRIORS
from bcid.inference.thresholds import THRESHOLDS

Array = NDArray[np.float64]
# A constant and a slope of this size have a mean square of 1 along a trajectory.
_OF_SLOW = math.sqrt(3 / 4)
# What was not seen has a noise so many times as large: it tells nothing.
_UNSEEN = 1e4
# Columns that are smaller than this part of the noise are left out.
_NEGLIGIBLE = 1e-6


@dataclass(frozen=True)
class _LowRank:
    """(I + L L^T)^(-1/2) for columns L of some rows, as I - U diag(shrink) U^T."""

    rows: NDArray[np.int64]
    basis: Array
    shrink: Array

    @classmethod
    def of(cls, rows: NDArray[np.int64], columns: Array) -> _LowRank:
        """For columns (rows, m), in units of the noise."""
        basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        kept = sizes > _NEGLIGIBLE
        return cls(rows, basis[:, kept], 1 - 1 / np.sqrt(1 + sizes[kept] ** 2))

    def apply(self, values: Array) -> None:
        """To values (n,) or columns (n, m), in place."""
        self._scale(values, -self.shrink)

    def undo(self, values: Array) -> None:
        """The inverse, in place."""
        self._scale(values, self.shrink / (1 - self.shrink))

    def _scale(self, values: Array, by: Array) -> None:
        along = self.basis.T @ values[self.rows]
        values[self.rows] += self.basis @ (by * along if values.ndim == 1 else by[:, None] * along)

    @property
    def log_volume(self) -> float:
        return -float(np.sum(np.log1p(-self.shrink)))

    @property
    def weighed(self) -> Array:
        """Columns B, such that its square is I - B B'."""
        return self.basis * np.sqrt(self.shrink * (2 - self.shrink))


@dataclass(frozen=True)
class NuisanceEstimate:
    """What the data say of a nuisance.

    Attributes:
        name: as in the scene's table of uncertainty.
        size: standard deviation that was believed before, in m, deg or 1.
        found: root mean square of the values that the data make likely, in the same unit.
        most: the largest of them, in standard deviations.
        count: how many values there are.
    """

    name: str
    size: float
    found: float
    most: float
    count: int

    @property
    def used_up(self) -> bool:
        """Whether a value is larger than chance lets expect of so many: the scene is wrong by more than it says."""
        return bool(2 * self.count * normal_tail(self.most) < THRESHOLDS.surprise)


class ErrorCovariance:
    """Covariance of the residual: noise, nuisances, the error of the mesh as far as the ladder tells, and that of the frame.

    The error of the mesh that is left after extrapolation has the shape of the extrapolation with an uncertain factor per
    action, and beside it parts that persist along every trajectory (a constant and a slope along the steps) and that each
    fiducial has in common in all actions. What is left at rest, as where a weight acts, is the same in all of them: it has one
    factor, and a part of each fiducial.

    Args:
        data: the measured values.
        sigma: standard deviation of the noise, shape (n,), m.
        mesh: what the ladder says.
        nuisances: what the scene may have wrong; nothing by default.
    """

    def __init__(self, data: Data, sigma: Array, mesh: MeshError, nuisances: NuisanceModes | None = None) -> None:
        self.data, self.sigma, self.mesh = data, sigma, mesh
        self.nuisances = nuisances or NuisanceModes.none(len(data))
        self._single: list[_LowRank] = []
        rest = _at_rest(data, mesh.left)
        moving = data.vector(mesh.left) - rest
        for rows, columns in self._of_fiducials(moving, rest):
            self._single.append(_LowRank.of(rows, columns / sigma[rows, None]))
        self._modes = self._of_nuisances()
        common = np.column_stack([self._of_actions(moving, rest), self._of_frame(), self._modes])
        scaled = common / sigma[:, None]
        for part in self._single:
            part.apply(scaled)
        self._common = _LowRank.of(np.arange(len(data)), scaled)

    def without(self, names: Collection[str], fiducials: Collection[str] = ()) -> ErrorCovariance:
        """The same where some nuisances, and the places of some fiducials, are not integrated over, because they are fitted."""
        kept = self.nuisances.without(names)
        if fiducials:
            apart = np.isin(self.data.fiducial, [self.data.names.index(name) for name in fiducials])
            kept = replace(kept, markers=np.where(apart[:, None], 0.0, kept.markers))
        return self if kept is self.nuisances else ErrorCovariance(self.data, self.sigma, self.mesh, kept)

    def masked(self, rows: NDArray[np.bool_]) -> ErrorCovariance:
        """The same as if some of the values (n,) had not been measured: whatever they are, they tell nothing."""
        return ErrorCovariance(self.data, np.where(rows, _UNSEEN, 1.0) * self.sigma, self.mesh, self.nuisances)

    @cached_property
    def misfits(self) -> list[LowRankDiscrepancy]:
        """A misfit in observation space beside these errors, for each of its lengths, see `bcid.inference.response`."""
        return response.processes(self.data, self.sigma, self.whiten)

    @property
    def mesh_rms(self) -> float:
        """RMS of what may be left of the error of the mesh, of the positions that are compared, m.

        Of frames that are left out, as where a body buckles and two meshes go apart, it is no measure.
        """
        return self.data.rms(self.data.vector(self.mesh.left))

    # -- columns, m

    def _of_actions(self, moving: Array, rest: Array) -> Array:
        """The factor of each action's extrapolation, that of rest, and that of forces."""
        found = [
            np.where(self.data.action == number, PRIORS.mesh_error[0] * moving, 0.0)
            for number in range(len(self.data.actions))
        ]
        found.append(PRIORS.mesh_error[0] * rest)
        found.append(np.where(self.data.kind > 0, PRIORS.mesh_error[3] * (moving + rest), 0.0))
        return np.column_stack([column for column in found if column.any()] or [np.zeros((len(self.data), 0))])

    def _of_nuisances(self) -> Array:
        """Those of all values; the error of the mesh in a force grows with the stiffness of the body as the force does."""
        modes, names = self.nuisances.common, self.nuisances.names
        if STIFFNESS not in names:
            return modes
        corrected = np.where(self.data.kind > 0, self.data.vector(self.mesh.correction), 0.0)
        stiffness = np.array(names) == STIFFNESS
        return np.asarray(modes + np.outer(self.nuisances.sizes[STIFFNESS] * corrected, stiffness))

    def _of_frame(self) -> Array:
        """What an error of the measured frame does to all values together."""
        error = self.data.measurement.frame_error
        if error is None:
            return np.zeros((len(self.data), 0))
        return self.data.moved(error.modes(self.data.points))

    def _of_fiducials(self, moving: Array, rest: Array) -> Iterator[tuple[NDArray[np.int64], Array]]:
        """What each fiducial has for itself: the rest of the mesh's error, and where it sits on the body."""
        data, markers = self.data, self.nuisances.markers
        growing, lasting = (_by_kind(data, left) for left in (moving, rest))
        along = _along(data, moving)
        order = np.argsort(data.fiducial, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(data.fiducial[order])) + 1):
            columns, kind = [markers[rows]] if markers[rows].any() else [], data.kind[rows[0]]
            if growing[kind] > 0 or data.slow[rows].any():
                columns.append(_apart(data.trajectory[rows], along[rows]))
            if growing[kind] > 0:
                columns.append(growing[kind] * data.way[rows, None] * data.seen.directions[rows])
            if lasting[kind] > 0:
                columns.append(lasting[kind] * data.seen.directions[rows])
            if columns:
                yield rows, np.hstack(columns)

    # -- the algebra

    def whiten(self, values: Array) -> Array:
        """Values (n,) or columns (n, m), m, in units in which their errors are independent and of size one."""
        scaled = np.asarray(values / (self.sigma if values.ndim == 1 else self.sigma[:, None]))
        for part in (*self._single, self._common):
            part.apply(scaled)
        return scaled

    def unwhiten(self, values: Array) -> Array:
        """The inverse of `whiten` for values (n,): back to m."""
        scaled = np.array(values)
        for part in (self._common, *self._single):
            part.undo(scaled)
        return np.asarray(scaled * self.sigma)

    def explaining(self) -> Iterator[tuple[NDArray[np.int64], Array]]:
        """Columns B, (rows, k) for some rows each, such that the inverse of the covariance in units of the noise is I - B B'."""
        for part in self._single:
            yield part.rows, part.weighed
        common = self._common.weighed
        for part in self._single:
            part.apply(common)
        yield self._common.rows, common

    @property
    def log_volume(self) -> float:
        """Half the logarithm of the determinant of the covariance, of it in m."""
        return float(np.sum(np.log(self.sigma))) + sum(part.log_volume for part in (*self._single, self._common))

    def log_likelihood(self, residual: Array) -> float:
        """Logarithm of the density of a residual (n,), m, without the constant of n values."""
        scaled = self.whiten(residual)
        return -0.5 * float(scaled @ scaled) - self.log_volume

    def rough(self, residual: Array) -> Array:
        """The part of a residual (n,), m, that is most likely noise: what neither nuisances nor mesh nor frame explain."""
        return np.asarray(self.weighed(self.whiten(residual)) * self.sigma)

    def weighed(self, scaled: Array) -> Array:
        """What is whitened, (n,) or (n, m), as weights of values in units of the noise: the transpose of the whitening."""
        found = np.array(scaled)
        for part in (self._common, *self._single):
            part.apply(found)
        return found

    def expected(self, residual: Array) -> Array:
        """The part of a residual (n,), m, that nuisances, mesh and frame most likely have: the mean of it given the values.

        Of values that were not seen what the others tell (Rasmussen & Williams 2006, equation 2.19).
        """
        return np.asarray(residual - self.rough(residual))

    def likeliest(self, residual: Array) -> Array:
        """Values of the nuisances of all fiducials together, (k,), in their standard deviations: means given a residual (n,), m."""
        return np.asarray(self._modes.T @ (self.rough(residual) / self.sigma**2))

    def of_nuisance(self, number: int) -> Array:
        """What one standard deviation of a nuisance does, by its column in `nuisances.common`, in units of the errors, (n,)."""
        return self.whiten(self._modes[:, number])

    def told(self, residual: Array) -> list[NuisanceEstimate]:
        """What a residual (n,), m, says of every nuisance: the mean of its values given the data."""
        weighed, common = self.rough(residual) / self.sigma**2, self.likeliest(residual)
        names = np.array(self.nuisances.names)
        of_markers = np.zeros((int(self.data.fiducial.max()) + 1, 3))
        np.add.at(of_markers, self.data.fiducial, self.nuisances.markers * weighed[:, None])
        found = []
        seen = np.unique(self.data.fiducial[self.data.of_position])
        for name, size in self.nuisances.sizes.items():
            values = of_markers[seen] if name == MARKERS else common[names == name]
            rms, most = float(np.sqrt(np.mean(values**2))), float(np.abs(values).max())
            found.append(NuisanceEstimate(name, size, size * rms, most, values.size))
        return found

    def values(self, residual: Array, name: str, fitted: Array | None = None) -> tuple[Array, Array]:
        """Values of a nuisance given a residual (n,), m: means (k,) and covariance (k, k), in its standard deviations.

        `fitted` are columns (n, p), m, of numbers that were fitted to the same data: they could be others with it.
        """
        others = self.without([name])
        seen = others.whiten(self._modes[:, np.array(self.nuisances.names) == name])
        if fitted is not None and fitted.size:
            basis = np.linalg.svd(others.whiten(fitted), full_matrices=False)[0]
            seen = seen - basis @ (basis.T @ seen)
        covariance = np.asarray(np.linalg.inv(np.eye(seen.shape[1]) + seen.T @ seen))
        return covariance @ (seen.T @ others.whiten(residual)), covariance

    def estimate(self, residual: Array, name: str, fitted: Array | None = None) -> tuple[float, float] | None:
        """Mean and standard deviation of a nuisance of one number; None where it is not allowed for. See `values`."""
        if name not in self.nuisances.names:
            return None
        means, covariance = self.values(residual, name, fitted)
        size = self.nuisances.sizes[name]
        return size * float(means[0]), size * math.sqrt(covariance[0, 0])


def _at_rest(data: Data, left: Array) -> Array:
    """What the mesh leaves before the gripper moves, of each value, (n,), from that in all frames, (frames, rows, 3), m."""
    first = data.measurement.data["step"].values == 0
    if not first.any():
        return np.zeros(len(data))
    return data.vector(np.broadcast_to(np.nan_to_num(left[first].mean(axis=0)), left.shape))


def _by_kind(data: Data, left: Array) -> dict[int, float]:
    """How much a fiducial may have of what the mesh leaves, of positions, forces and torques each, m."""
    return {
        int(k): float(np.sqrt(np.mean(left[data.kind == k] ** 2))) * PRIORS.mesh_error[2] for k in np.unique(data.kind)
    }


def _along(data: Data, left: Array) -> Array:
    """A constant and a slope along each trajectory, as large as what the mesh leaves and what of the noise persists, (n, 2)."""
    group = np.unique(np.column_stack([data.kind, data.action]), axis=0, return_inverse=True)[1].ravel()
    own, common = _mean(left**2, data.trajectory), _mean(left**2, group)
    amount = np.hypot(
        PRIORS.mesh_error[1] * np.sqrt(np.maximum(own, common)),
        _OF_SLOW * np.sqrt(_mean(data.slow**2, data.trajectory)),
    )
    order = np.argsort(data.trajectory, kind="stable")
    _, first, count = np.unique(data.trajectory[order], return_index=True, return_counts=True)
    along = np.empty(len(data))
    along[order] = (np.arange(len(data)) - np.repeat(first, count)) / np.repeat(np.maximum(count - 1, 1), count)
    along[order[first[count == 1]]] = 1.0
    # At rest there is no error; it grows with the motion.
    return np.asarray(
        (amount * np.minimum(1.0, 4 * along))[:, None] * np.column_stack([np.ones(len(data)), 2 * along - 1])
    )


def _mean(values: Array, group: NDArray[np.int64]) -> Array:
    """Of values (n,) the mean over those of the same group, (n,)."""
    return np.asarray((np.bincount(group, values) / np.maximum(np.bincount(group), 1))[group])


def _apart(number: NDArray[np.int64], values: Array) -> Array:
    """Values (rows, k) in columns of their own for each number (rows,), (rows, numbers * k)."""
    found, at = np.unique(number, return_inverse=True)
    columns = np.zeros((len(number), len(found), values.shape[1]))
    columns[np.arange(len(number)), at] = values
    return columns.reshape(len(number), -1)
