"""Something is missing: a smooth force of unknown size acts on the body besides what a model knows.

It stands for whatever the model lacks (a latent force; Kennedy & O'Hagan, J. R. Stat. Soc. B 63 (2001) 425). To first order
it moves the markers by the sensitivities of the model, so that the likelihood integrated over all such forces has a closed
form: it is a further part of the covariance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bcid.inference.data import Data
from bcid.inference.likelihood import Errors

Array = NDArray[np.float64]
# Standard deviations of the force's density that are equally likely, in units of shear modulus per size of the body: from a strain
# that nobody sees to one that tears.
_SIZES = np.logspace(-4, 1, 21)
# How often something is missing in a model that was taken for complete.
MISSING = 0.5


def courses(data: Data, slopes: Array) -> Array:
    """Movements (n, m), m per unit of each force, from the `slopes` (n, forces) of forces that act in a frame.

    Each may act in all frames alike, and grow along every action.
    """
    parts: list[Array] = [np.ones(len(data))]
    parts += [np.where(data.action == number, data.progress, 0.0) for number in np.unique(data.action)]
    return np.hstack([slopes * part[:, None] for part in parts])


@dataclass(frozen=True)
class Evidence:
    """How likely a residual is, without and with an unknown force; logarithms of densities.

    Attributes:
        plain: nothing is missing.
        forced: an unknown force acts, integrated over its size.
        size: the likeliest standard deviation of its density.
    """

    plain: float
    forced: float
    size: float

    @classmethod
    def of(cls, errors: Errors, residual: Array, moved: Array, unit: float) -> Evidence:
        """Of a residual (n,), m.

        Args:
            errors: of all else.
            residual: measured minus predicted.
            moved: movements (n, m), m per unit of force, see `courses`.
            unit: of the force's density: shear modulus per size of the body.
        """
        scaled, columns = errors.whiten(residual), errors.whiten(moved)
        # With columns C = U S V^T, (I + a^2 C C^T) has the eigenvalues 1 + a^2 s^2 along U, and 1 beside.
        squares, axes = np.linalg.eigh(columns.T @ columns)
        kept = squares > 1e-12 * max(squares.max(initial=0.0), 1e-300)
        squares, axes = squares[kept], axes[:, kept]
        along = (axes.T @ (columns.T @ scaled)) ** 2 / squares
        beside, volume = float(scaled @ scaled) - float(along.sum()), errors.log_volume
        found = []
        for size in _SIZES * unit:
            widths = 1 + size**2 * squares
            found.append(-0.5 * (beside + float(np.sum(along / widths + np.log(widths)))) - volume)
        plain = -0.5 * float(scaled @ scaled) - volume
        forced = float(logsumexp(found)) - math.log(len(found))
        return cls(plain, forced, float(_SIZES[int(np.argmax(found))] * unit))

    @property
    def total(self) -> float:
        """Whether or not something is missing."""
        return float(np.logaddexp(self.plain + math.log(1 - MISSING), self.forced + math.log(MISSING)))

    @property
    def missing(self) -> float:
        """Probability that something is."""
        return math.exp(self.forced + math.log(MISSING) - self.total)
