"""Robust planes through the points of many small pieces of a surface at once.

A point is either of the surface, with Gaussian noise about the plane of its piece, or anything else that is in view, anywhere as
likely; which one is a matter of probability (a mixture, fitted by expectation maximisation: Dempster, Laird & Rubin 1977). What
is too far away for the noise thereby does not count, and no length has to be set from which on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]
_ROUNDS = 30
# Standard deviation of Gaussian values per median of their sizes.
_PER_MEDIAN = 1.4826
# Part of the points that is of something else, to begin with, and within which it is looked for.
_SHARE, _LEAST, _MOST = 0.1, 1e-3, 0.9
# A noise is at least this part of the largest height.
_EXACT = 1e-5
# So many points that part is believed for before a piece's own.
_BELIEVED = 2.0
# How far a piece may be tilted against where it is expected: tangent of the angle, standard deviation.
_TILT = 0.3


@dataclass(frozen=True)
class Planes:
    """Planes of pieces: height above the middle of each is `offset` + `slope` . (place beside the middle).

    Attributes:
        offset: shape (pieces,), m; NaN where none is seen.
        slope: shape (pieces, 2), and its covariance `slope_covariance`, shape (pieces, 2, 2).
        sigma: standard deviation of the offset, m.
        noise: standard deviation of a point, m.
        counted: how many points are of each plane, none of those that are not seen, shape (pieces,).
    """

    offset: Array
    slope: Array
    slope_covariance: Array
    sigma: Array
    noise: float
    counted: Array


@dataclass(frozen=True)
class Pieces:
    """Points of pieces of a surface.

    Attributes:
        number: of the piece of each point, shape (n,).
        heights: of the points above where the surface is expected, shape (n,), m.
        across: their place beside the middle of the piece, shape (n, 2), m.
        stated: standard deviation of each, shape (n,), m; NaN where none is stated: the scatter tells it.
        allowed: how far each piece may be from where it is expected, standard deviation, shape (pieces,), m.
        usual: how many points each piece has where it is seen, shape (pieces,).
    """

    number: Numbers
    heights: Array
    across: Array
    stated: Array
    allowed: Array
    usual: Array

    @cached_property
    def shapes(self) -> Array:
        """What offset and slopes do to the heights, shape (n, 3)."""
        return np.column_stack([np.ones(len(self.heights)), self.across])

    def sums(self, values: Array) -> Array:
        """Of values (n,) by piece, shape (pieces,)."""
        return np.bincount(self.number, values, len(self.allowed)).astype(float)

    def medians(self) -> Array:
        """Median of the heights of each piece, zero where it has none, shape (pieces,)."""
        order = np.lexsort((self.heights, self.number))
        counts = np.bincount(self.number, minlength=len(self.allowed))
        first, there = np.cumsum(counts) - counts, counts > 0
        found, ordered = np.zeros(len(counts)), self.heights[order]
        low, high = (first + (counts - 1) // 2)[there], (first + counts // 2)[there]
        found[there] = (ordered[low] + ordered[high]) / 2
        return found

    def solved(self, weights: Array) -> tuple[Array, Array, float]:
        """Weighted least squares: solutions (pieces, 3), covariances (pieces, 3, 3), and how many numbers were fitted."""
        sums = [self.sums(weights * self.shapes[:, i] * self.shapes[:, j]) for i in range(3) for j in range(3)]
        data = np.stack(sums, axis=1).reshape(-1, 3, 3)
        right = np.stack([self.sums(weights * self.shapes[:, i] * self.heights) for i in range(3)], axis=1)
        inverse = np.linalg.inv(data + self._precision)
        return (
            np.einsum("cij,cj->ci", inverse, right),
            np.asarray(inverse),
            float(np.einsum("cij,cji->", inverse, data)),
        )

    @cached_property
    def _precision(self) -> Array:
        """Of what is expected of offset and slopes, shape (pieces, 3, 3); that of the offset only keeps the matrix regular."""
        found = np.zeros((len(self.allowed), 3, 3))
        found[:, 0, 0], found[:, 1, 1], found[:, 2, 2] = 1e-6 / self.allowed**2, _TILT**-2, _TILT**-2
        return found

    def shares(self, weights: Array) -> Array:
        """Part of the points of each piece that is of something else, (pieces,): of that there may be much around one alone."""
        everywhere = 1 - float(weights.mean()) if len(weights) else _SHARE
        found = (self.sums(1 - weights) + _BELIEVED * everywhere) / (self.sums(np.ones(len(weights))) + _BELIEVED)
        return np.clip(found, _LEAST, _MOST)

    def occam(self, solution: Array, covariance: Array) -> Array:
        """Logarithm of the part of what was expected of offset and slopes that the points leave, shape (pieces,)."""
        expected = np.column_stack([self.allowed, np.full((len(self.allowed), 2), _TILT)])
        volume = 0.5 * np.linalg.slogdet(covariance)[1] - np.log(expected).sum(axis=1)
        return np.asarray(volume - 0.5 * np.sum((solution / expected) ** 2, axis=1))


class _Fit:
    """The mixture of points of planes and of others, improved turn by turn; the attributes are those of `Planes` and `Pieces`.

    Attributes:
        noise: of a point, in units of the stated one, or in m.
        share: part of the points of each piece that is of something else, and `reach`, how far away those are at most, m.
        furthest: height of the highest point, m.
        seen: probability of each piece to be seen.
        weights: probability of each point to be of its plane.
    """

    def __init__(self, pieces: Pieces) -> None:
        self.pieces, count = pieces, len(pieces.allowed)
        self.known = len(pieces.stated) > 0 and bool(np.isfinite(pieces.stated).all())
        self.unit = pieces.stated if self.known else np.ones(len(pieces.heights))
        self.left: Array = pieces.heights - pieces.medians()[pieces.number]
        self.furthest = self.reach = max(float(np.abs(pieces.heights).max(initial=0.0)), 1e-12)
        # Where points lie in planes exactly nothing else keeps it from vanishing.
        self.least = 1.0 if self.known else _EXACT * self.furthest
        self.noise = max(_PER_MEDIAN * _median(np.abs(self.left / self.unit)), self.least)
        self.share: Array = np.full(count, _SHARE)
        self.seen: Array = np.ones(count)
        self.weights: Array = np.ones(len(pieces.heights))
        self.solution: Array = np.zeros((count, 3))
        self.covariance: Array = np.zeros((count, 3, 3))

    def odds(self) -> Array:
        """Logarithm of the odds of each point to be of its plane, shape (n,)."""
        return _log_odds(self.left, (self.noise * self.unit) ** 2, self.reach, self.share[self.pieces.number])

    def turn(self) -> None:
        """Weigh the points, fit the planes, and learn noise and others from what they leave."""
        pieces = self.pieces
        self.weights = expit(self.odds()) * self.seen[pieces.number]
        self.solution, self.covariance, used = pieces.solved(self.weights / (self.noise * self.unit) ** 2)
        self.left = pieces.heights - np.einsum("nk,nk->n", pieces.shapes, self.solution[pieces.number])
        total = max(float(self.weights.sum()), 1e-300)
        squares = float(self.weights @ (self.left / self.unit) ** 2)
        self.noise = max(math.sqrt(squares / max(total - used, 0.1 * total)), self.least)
        self.share = pieces.shares(self.weights)
        others = 1 - self.weights
        # Of values that are uniform up to a limit the root mean square is that part of it.
        furthest = math.sqrt(3 * float(others @ pieces.heights**2) / max(float(others.sum()), 1e-300))
        self.reach = max(furthest, 3 * self.point)

    def look(self) -> None:
        """Which pieces are seen.

        Points of something else would have to lie in a plane by chance, and where a piece is seen there are about as many as usual
        (a Poisson process of points of the surface beside one of others).
        """
        gains = self.pieces.sums(np.logaddexp(0.0, self.odds()))
        expected = self.weights.mean() * self.pieces.usual if len(self.weights) else self.pieces.usual
        by_chance = expected - gains - self.pieces.occam(self.solution, self.covariance)
        self.seen = expit(-np.logaddexp(by_chance, self.elsewhere()))

    def elsewhere(self) -> Array:
        """Logarithm of the odds of each piece to be a surface of something else, which may be anywhere, shape (pieces,)."""
        return -_log_odds(self.solution[:, 0], self.pieces.allowed**2 + self.covariance[:, 0, 0], self.furthest, _SHARE)

    @property
    def point(self) -> float:
        """Standard deviation of a point, m."""
        return self.noise * _median(self.unit)

    def planes(self) -> Planes:
        """Of the pieces that are seen; a plane that is known no better than a point of it tells nothing."""
        sigma = np.sqrt(self.covariance[:, 0, 0])
        told = (self.seen > 0.5) & (sigma < self.point)
        offset, sigma = (np.where(told, values, np.nan) for values in (self.solution[:, 0], sigma))
        counted = np.where(told, self.pieces.sums(self.weights), 0.0)
        return Planes(offset, self.solution[:, 1:], self.covariance[:, 1:, 1:], sigma, self.point, counted)


def fit_planes(pieces: Pieces) -> Planes:
    """Planes through the points of pieces, of those that are seen."""
    fit = _Fit(pieces)
    for turn in range(_ROUNDS):
        fit.turn()
        if turn >= _ROUNDS // 3:
            fit.look()
    return fit.planes()


def spread_about_zero(values: Array) -> tuple[float, Array]:
    """Standard deviation of values (n,) about zero where others are among them, and the probability of each to be none, (n,)."""
    reach = max(float(np.abs(values).max(initial=0.0)), 1e-12)
    spread, share, weights = reach / 2, _SHARE, np.ones(len(values))
    for _ in range(_ROUNDS):
        weights = expit(_log_odds(values, np.full(len(values), spread**2), reach, share))
        share = float(np.clip(1 - weights.mean(), _LEAST, _MOST)) if len(values) else _SHARE
        spread = max(float(np.sqrt(weights @ values**2 / max(weights.sum(), 1e-300))), 1e-9 * reach)
    return spread, weights


def _median(values: Array) -> float:
    return float(np.median(values)) if len(values) else 1.0


def _log_odds(left: Array, variances: Array, reach: float, share: float | Array) -> Array:
    """Logarithm of the odds of each point to be of the surface that it misses by `left`, m, shape (n,)."""
    near = -0.5 * (left**2 / variances + np.log(2 * np.pi * variances))
    return np.asarray(near + np.log(2 * reach) + np.log1p(-share) - np.log(share))
