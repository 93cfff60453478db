"""Kriging: a smooth field from values at scattered points that have noise, and how far it may be off.

A field is a trend (a constant, and a slope along each axis in which the points are spread) and a Gaussian process with Matern's
covariance of order 3/2; it is estimated without bias, whatever the trend (universal kriging: Cressie, Statistics for Spatial
Data, 1993, section 3.4). Length and variance of the process are those of the largest restricted likelihood (the same, section
2.6). A body that is not even all over is less smooth than a squared exponential would have it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

Array = NDArray[np.float64]
# Lengths of the process that are compared, in extents of the points, and variances of the noise, in those of the process.
_LENGTHS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
_RATIOS = tuple(np.logspace(-8, 2, 21))
# Modes are as many as have this part of the variance.
_ENOUGH = 0.98
# Points have a slope along axes in which they are spread by more than this part of their largest extent.
_SPREAD = 0.1


@dataclass(frozen=True)
class Kriging:
    """An estimate of a field from its values at points.

    Attributes:
        points: shape (p, 3), m.
        length: of the process, m.
        ratio: variance of the noise, in units of that of the process.
        scale: standard deviation of the process, in the unit of the values.
    """

    points: Array
    length: float
    ratio: float
    scale: float

    @classmethod
    def of(cls, points: Array, values: Array, noise: float | None = None) -> Kriging:
        """Of values (p, m) of m fields at points (p, 3), m, at least three, and the standard deviation of their noise if known."""
        extent = max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-12)
        tried = [cls(points, part * extent, ratio, 1.0) for part in _LENGTHS for ratio in _RATIOS]
        likelihoods, scales = zip(*(one._likelihood(values, noise) for one in tried), strict=True)
        best = int(np.argmax(likelihoods))
        return cls(points, tried[best].length, tried[best].ratio, scales[best])

    @property
    def noise(self) -> float:
        """Standard deviation of the noise, in the unit of the values."""
        return self.scale * float(np.sqrt(self.ratio))

    def weights(self, at: Array) -> Array:
        """What the estimate at places (n, 3), m, is of the values: shape (n, p)."""
        kernel, unbiased = self._kernel(at, self.points), self._unbiased(at)
        return np.asarray(cho_solve(self._factor, kernel.T).T + unbiased @ self._slopes_of)

    def covariance(self, at: Array, other: Array) -> Array:
        """Of the errors at places (n, 3) and (m, 3), m, without what noise has done: shape (n, m)."""
        one, two = self._kernel(at, self.points), self._kernel(other, self.points)
        known = one @ cho_solve(self._factor, two.T)
        trend = self._unbiased(at) @ np.linalg.solve(self._information, self._unbiased(other).T)
        seen = self.ratio * self.weights(at) @ self.weights(other).T
        return np.asarray(self.scale**2 * (self._kernel(at, other) - known + trend - seen))

    def error_modes(self, at: Array, reference: Array, most: int) -> tuple[Array, Array]:
        """Errors by noise of size one, and all others, as independent modes at places (n, 3), m: (n, k) each, k at most `most`.

        They are the largest at reference places (m, 3), m, and continued from there (Rasmussen & Williams 2006, section 4.3.2).
        """
        there, here = self.weights(reference), self.weights(at)
        noise = _continued(there @ there.T, here @ there.T, most)
        return noise, _continued(self.covariance(reference, reference), self.covariance(at, reference), most)

    # -- the algebra

    @cached_property
    def _factor(self) -> tuple[Array, bool]:
        covariance = self._kernel(self.points, self.points) + self.ratio * np.eye(len(self.points))
        return cho_factor(covariance + 1e-10 * np.eye(len(self.points)), lower=True)

    @cached_property
    def _axes(self) -> Array:
        """Directions in which the points are spread, of extent one, shape (3, k); fewer than there are points by two."""
        _, sizes, directions = np.linalg.svd(self.points - self._middle, full_matrices=False)
        count = min(int((sizes > _SPREAD * max(sizes[0], 1e-30)).sum()), max(len(self.points) - 2, 0))
        return np.asarray(directions[:count].T / np.maximum(sizes[:count], 1e-30))

    @cached_property
    def _middle(self) -> Array:
        return np.asarray(self.points.mean(axis=0))

    def _trend(self, at: Array) -> Array:
        return np.column_stack([np.ones(len(at)), (at - self._middle) @ self._axes])

    @cached_property
    def _information(self) -> Array:
        """Of the trend's coefficients, (q, q)."""
        trend = self._trend(self.points)
        return np.asarray(trend.T @ cho_solve(self._factor, trend))

    @cached_property
    def _slopes_of(self) -> Array:
        """The trend's coefficients of the values, (q, p)."""
        return np.asarray(np.linalg.solve(self._information, cho_solve(self._factor, self._trend(self.points)).T))

    def _unbiased(self, at: Array) -> Array:
        """What of the trend at places is not met by the process, (n, q)."""
        met = cho_solve(self._factor, self._trend(self.points))
        return np.asarray(self._trend(at) - self._kernel(at, self.points) @ met)

    def _kernel(self, one: Array, other: Array) -> Array:
        """Matern's covariance of order 3/2, of variance one."""
        apart = np.sqrt(3) / self.length * cdist(one, other)
        return np.asarray((1 + apart) * np.exp(-apart))

    def _likelihood(self, values: Array, noise: float | None) -> tuple[float, float]:
        """Restricted log-likelihood of values (p, m), and the standard deviation of the process; the likeliest for no `noise`."""
        fields = values.shape[1]
        free = fields * max(len(values) - self._information.shape[0], 1)
        residual = values - self._trend(self.points) @ (self._slopes_of @ values)
        square = float(np.sum(residual * cho_solve(self._factor, residual)))
        variance = square / free if noise is None else noise**2 / self.ratio
        variance = max(variance, 1e-30)
        volume = 2 * float(np.log(np.diag(self._factor[0])).sum()) + float(np.linalg.slogdet(self._information)[1])
        return -0.5 * (free * float(np.log(variance)) + fields * volume + square / variance), float(np.sqrt(variance))


def _continued(covariance: Array, onward: Array, most: int) -> Array:
    """Modes whose squares add up to nearly all of a covariance at reference places, (m, m), at others by that with it, (n, m)."""
    sizes, modes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    order = np.argsort(-sizes)
    parts = np.cumsum(np.maximum(sizes[order], 0.0)) / max(float(np.maximum(sizes, 0.0).sum()), 1e-30)
    kept = order[: min(most, 1 + int(np.searchsorted(parts, _ENOUGH)))]
    kept = kept[sizes[kept] > 1e-9 * max(float(sizes[order[0]]), 1e-30)]
    return np.asarray(onward @ (modes[:, kept] / np.sqrt(sizes[kept])))
