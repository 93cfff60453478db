"""Evidence: how likely a measurement is under a hypothesis, integrated over its unknown numbers and over an unknown force.

With a residual r at numbers a, in units of its errors, J its derivative and S the standard deviations believed before, the
model is linear about a: the residual at the values m that were expected is r + J (a - m), and its covariance I + J S^2 J'. So

    log Z = - |r + J (a - m)|^2 / 2 + b' M^-1 b / 2 - log det(M) / 2,    M = 1 + S J'J S,    b = S J' (r + J (a - m)),

which is Laplace's approximation about a fit (MacKay, Information Theory, 2003, chapter 28; Kass & Raftery, J. Am. Stat. Assoc. 90,
1995), and the score test where the numbers were not fitted. S is not known: it is averaged over the rows of a table.

An unknown force is a part of the covariance with very many columns F: the same algebra in the basis in which F F' is diagonal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, logsumexp

from bcid.inference.priors import PRIORS, spaced

Array = NDArray[np.float64]
# Where no noise is stated errors may be larger than they are taken for by any of these factors, all equally likely.
LARGER: Array = spaced(PRIORS.noise)


@dataclass(frozen=True)
class LinearParameters:
    """Unknown numbers of a hypothesis.

    Attributes:
        columns: change of the predicted values per unit of each number, in units of their errors, shape (n, p).
        apart: the numbers minus what was expected of them, shape (p,).
        widths: standard deviations that are equally likely, one row each, shape (rows, p).
        positive: which numbers cannot be below what was expected of them, shape (p,).
        log_prior: logarithm of the prior probability of what is no number: a place, a first frame; and of the rows that are left.
    """

    columns: Array
    apart: Array
    widths: Array
    positive: NDArray[np.bool_]
    log_prior: float = 0.0

    @classmethod
    def none(cls, count: int) -> LinearParameters:
        """Nothing is unknown."""
        return cls(np.zeros((count, 0)), np.zeros(0), np.zeros((1, 0)), np.zeros(0, bool))


@dataclass(frozen=True)
class LowRankDiscrepancy:
    """An unknown force, in the basis in which what it does to the values is independent.

    Attributes:
        basis: orthonormal, shape (n, k).
        squares: variance along each of its directions per unit of the force's variance, shape (k,).
        sizes: standard deviations of the force that are equally likely, shape (m,).
        inflation: factor of all errors at each size, for what the columns leave out of a process; None for one, shape (m,).
    """

    basis: Array
    squares: Array
    sizes: Array
    inflation: Array | None = None

    @classmethod
    def of(cls, columns: Array, sizes: Array, left_out: float = 0.0) -> LowRankDiscrepancy:
        """Of columns (n, forces), in units of the errors per unit of force.

        `left_out` is the variance per value of a process that the columns leave out, in the square of these units. It makes all
        errors larger by sqrt(1 + left_out size^2), so that a process of low rank has the variance of the whole one.
        """
        squares, axes = np.linalg.eigh(columns.T @ columns)
        kept = squares > 1e-10 * max(float(squares.max(initial=0.0)), 1e-300)
        squares, axes = squares[kept], axes[:, kept]
        inflation = np.sqrt(1 + left_out * sizes**2) if left_out > 0 else None
        return cls(columns @ axes / np.sqrt(squares), squares, sizes, inflation)


@dataclass(frozen=True)
class KnownNuisance:
    """A nuisance that is known instead of integrated over.

    Attributes:
        column: what one standard deviation of it does, which the errors contain, in units of these errors, shape (n,).
        values: that it may have, in its standard deviations, shape (values,).
    """

    column: Array
    values: Array


@dataclass(frozen=True)
class _Products:
    """Products of residual and columns with the inverse of the covariance, and half the logarithm of its determinant, by size.

    Shapes (sizes,), (sizes, p), (sizes, p, p), (sizes,).
    """

    rr: Array
    rj: Array
    jj: Array
    volume: Array

    def inflated(self, factors: Array, count: int) -> _Products:
        """The same where all errors of so many values are larger by a factor for each size."""
        f = factors**2
        volume = self.volume + count * np.log(factors)
        return _Products(self.rr / f, self.rj / f[:, None], self.jj / f[:, None, None], volume)

    def knowing(self, values: Array) -> _Products:
        """The same for each of some values of a nuisance, whose column is the last: leading shape (values * sizes,).

        The residual loses what that value does, and the covariance the square of the column (Woodbury's identity).
        """
        v = values[:, None]
        rw, jw, ww = self.rj[:, -1], self.jj[:, :-1, -1], self.jj[:, -1, -1]
        left = 1 - ww
        beside = (rw - v * ww) / np.sqrt(left)
        along = jw / np.sqrt(left)[:, None]
        rr = self.rr - 2 * v * rw + v**2 * ww + beside**2
        rj = self.rj[:, :-1] - v[..., None] * jw + beside[..., None] * along
        jj = self.jj[:, :-1, :-1] + along[:, :, None] * along[:, None, :]
        count = len(values)
        volume = np.tile(self.volume + 0.5 * np.log(left), count)
        return _Products(rr.ravel(), rj.reshape(rr.size, rj.shape[2]), np.tile(jj, (count, 1, 1)), volume)


@dataclass(frozen=True)
class MarginalLikelihood:
    """What is left of a residual once the unknown numbers are integrated over, for each size of a force and each row of widths.

    Attributes:
        squares: chi-square, shape (sizes, rows).
        volumes: half the logarithm of the determinant of the covariance, likewise.
        inside: logarithm of the share within bounds, likewise.
        forced: logarithm of the density for each size while no number is unknown, shape (sizes,).
        count: values of the residual.
        log_prior: see `LinearParameters`.
        values: how many values of a nuisance that is known the sizes are of, one after the other.
    """

    squares: Array
    volumes: Array
    inside: Array
    forced: Array
    count: int
    log_prior: float
    values: int = 1

    @classmethod
    def of(
        cls,
        scaled: Array,
        numbers: LinearParameters,
        force: LowRankDiscrepancy | None = None,
        known: KnownNuisance | None = None,
    ) -> MarginalLikelihood:
        """Of a residual at the numbers, in units of its errors, shape (n,), and a force that may act besides.

        With a nuisance that is `known`, for each of its values.
        """
        columns = numbers.columns if known is None else np.column_stack([numbers.columns, known.column])
        products = _alone(scaled, columns) if force is None else _forced(scaled, columns, force)
        values = 1
        if known is not None:
            products, values = products.knowing(known.values), len(known.values)
        if force is not None and force.inflation is not None:
            products = products.inflated(np.tile(force.inflation, values), len(scaled))
        forced = -0.5 * products.rr - products.volume
        return cls(*_integrated(products, numbers), forced, len(scaled), numbers.log_prior, values)

    def log(self, factors: Array | None = None) -> float:
        """Logarithm of the density of the residual, without that of its errors alone and the constant of n values.

        All sizes and widths are equally likely, and so are the `factors` by which the errors may be larger than they are taken
        for; they are known by default.
        """
        return float(self.logs(factors)[0])

    def cells(self, factors: Array | None = None) -> Array:
        """The same of each size, row of widths and factor: logarithms of what adds up to the density, shape (cells,)."""
        squares, volumes = self.squares.ravel(), self.volumes.ravel()
        if factors is None:
            found = _density(squares, volumes, self.count, None) + self.inside.ravel()
        else:
            found = (_each(squares, volumes, self.count, factors) + self.inside.reshape(-1, 1)).ravel()
        return np.asarray(found - math.log(len(found)) + self.log_prior)

    def logs(self, factors: Array | None = None) -> Array:
        """The same for each value of a nuisance that is known, shape (values,)."""
        found = _density(self.squares.ravel(), self.volumes.ravel(), self.count, factors) + self.inside.ravel()
        each = found.reshape(self.values, -1)
        return np.asarray(logsumexp(each, axis=1) - math.log(each.shape[1]) + self.log_prior)


def log_gains(
    scaled: Array, columns: Array, widths: Array, positive: NDArray[np.bool_], factors: Array | None = None
) -> Array:
    """Of many variants of an effect, each with as many amounts, how much likelier they make a residual: shape (variants,).

    Args:
        scaled: the residual, in units of its errors, shape (n,).
        columns: what the amounts of each variant do, shape (n, variants, amounts).
        widths: standard deviations of the amounts that are equally likely, shape (rows, amounts).
        positive: which amounts cannot be negative, shape (amounts,).
        factors: as of `MarginalLikelihood.log`.
    """
    rr, rj = float(scaled @ scaled), np.einsum("n,nva->va", scaled, columns)
    jj = np.einsum("nva,nvb->vab", columns, columns, optimize=True)
    return gains_of(rr, rj, jj, len(scaled), widths, positive, factors)


def gains_of(
    rr: float,
    rj: Array,
    jj: Array,
    count: int,
    widths: Array,
    positive: NDArray[np.bool_],
    factors: Array | None = None,
) -> Array:
    """The same from products of residual and columns: the residual's square, (variants, amounts), (variants, amounts, amounts)."""
    found = []
    for width in widths:
        matrix = np.eye(rj.shape[1]) + width[:, None] * jj * width
        right = width * rj
        solved = np.linalg.solve(matrix, right[..., None])[..., 0]
        squares = np.maximum(rr - np.sum(right * solved, axis=1), 0.0)
        logs = _density(squares, 0.5 * np.linalg.slogdet(matrix)[1], count, factors)
        if positive.any():
            deviation = np.sqrt(np.diagonal(np.linalg.inv(matrix), axis1=1, axis2=2))
            logs = logs + np.sum((log_ndtr(solved / deviation) + math.log(2))[:, positive], axis=1)
        found.append(logs)
    nothing = float(_density(np.array([rr]), np.zeros(1), count, factors)[0])
    return np.asarray(logsumexp(found, axis=0)) - math.log(len(found)) - nothing


def _alone(scaled: Array, columns: Array) -> _Products:
    return _Products(np.array([scaled @ scaled]), (columns.T @ scaled)[None], (columns.T @ columns)[None], np.zeros(1))


def _forced(scaled: Array, columns: Array, force: LowRankDiscrepancy) -> _Products:
    """For each size of the force."""
    plain = _alone(scaled, columns)
    r, j = force.basis.T @ scaled, force.basis.T @ columns
    # Where all errors are larger by a factor the force is smaller beside them.
    sizes = force.sizes if force.inflation is None else force.sizes / force.inflation
    widths = 1 + sizes[:, None] ** 2 * force.squares
    lost = 1 - 1 / widths
    rr, rj = plain.rr - lost @ r**2, plain.rj - (lost * r) @ j
    jj = plain.jj - (lost[:, None, :] * j.T) @ j
    return _Products(rr, rj, jj, 0.5 * np.sum(np.log(widths), axis=1))


def _integrated(p: _Products, numbers: LinearParameters) -> tuple[Array, Array, Array]:
    """Squares, volumes and logarithm of the share within bounds, for each size and each row of widths, each (sizes, rows)."""
    apart, widths = numbers.apart, numbers.widths
    there = p.rj + p.jj @ apart
    matrix = np.eye(len(apart)) + widths[:, :, None] * p.jj[:, None] * widths[:, None, :]
    right = widths * there[:, None]
    solved = np.linalg.solve(matrix, right[..., None])[..., 0]
    squares = p.rr + (p.rj + there) @ apart
    squares = np.maximum(squares[:, None] - np.sum(right * solved, axis=2), 0.0)
    volumes = p.volume[:, None] + 0.5 * np.linalg.slogdet(matrix)[1]
    inside = np.zeros_like(squares)
    if numbers.positive.any():
        deviation = np.sqrt(np.diagonal(np.linalg.inv(matrix), axis1=2, axis2=3))
        inside = np.sum((log_ndtr(solved / deviation) + math.log(2))[..., numbers.positive], axis=2)
    return squares, volumes, inside


def _density(squares: Array, volumes: Array, count: int, factors: Array | None) -> Array:
    if factors is None:
        return np.asarray(-0.5 * squares - volumes)
    return np.asarray(logsumexp(_each(squares, volumes, count, factors), axis=1) - math.log(len(factors)))


def _each(squares: Array, volumes: Array, count: int, factors: Array) -> Array:
    """Logarithms of the density for each of some factors, shape (squares, factors)."""
    return np.asarray(-0.5 * squares[:, None] / factors**2 - count * np.log(factors) - volumes[:, None])
