"""How stiff the body is, as known forces tell.

The prior of all stiffnesses together is log-normal about those of the model. The likelihood is Gaussian in the factor f = exp(l)
that they are multiplied by, with mean m and variance v, so that the posterior of l has its mode where

    (exp(l) - m) exp(l) / v + l / s^2 = 0,

and about it the variance of Laplace's approximation. No stiffness is ever negative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from bcid.base.units import WIDE, unit_factor
from bcid.forms.model import Model
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.nuisances import STIFFNESS
from bcid.results.common_rows import StiffnessRecord, StiffnessRow
from bcid.scene import Scene

Array = NDArray[np.float64]
_PER_THICKNESS = "N/mm"


@dataclass(frozen=True)
class StiffnessScale:
    """How a stiffness of a computed sheet or body is reported.

    Attributes:
        factor: number that is reported for one Pa.
        unit: of it.
        per_thickness: whether a constant is multiplied by the thickness.
    """

    factor: float = 1.0
    unit: str = "Pa"
    per_thickness: bool = False

    @classmethod
    def of(cls, scene: Scene) -> StiffnessScale:
        """Forces tell the product of stiffness and thickness alone: where the thickness is unknown, that is reported."""
        if scene.thickness is None or scene.thickness_known:
            return cls()
        return cls(scene.thickness / unit_factor(_PER_THICKNESS, "N/m"), _PER_THICKNESS, True)


@dataclass(frozen=True)
class Stiffness:
    """Of the law's constants that are stiffnesses, all together.

    Attributes:
        log: logarithm of what those of the model are to be multiplied by.
        log_error: its standard deviation.
        constants: those of the model, Pa.
        stated: those of the scene, Pa.
        scale: how they are reported.
    """

    log: float
    log_error: float
    constants: Mapping[str, float]
    stated: Mapping[str, float]
    scale: StiffnessScale = StiffnessScale()

    @classmethod
    def of(
        cls, errors: ErrorCovariance, residual: Array, model: Model, scene: Scene, fitted: Array | None = None
    ) -> Stiffness | None:
        """From a residual (n,), m; None where no force is measured, or the scene takes its stiffness for exact.

        Args:
            errors: of the residual, with the stiffness among its nuisances.
            model: that it was predicted with.
            scene: where that began.
            fitted: columns (n, p), m, by which numbers that were fitted to the same data change what is predicted.
        """
        found = errors.estimate(residual, STIFFNESS, fitted)
        if found is None:
            return None
        log, error = log_factor(*found, errors.nuisances.sizes[STIFFNESS])
        return cls(log, error, model.stiffnesses, Model.of(scene).stiffnesses, StiffnessScale.of(scene))

    @property
    def factor(self) -> float:
        """What the constants of the model are to be multiplied by."""
        return math.exp(self.log)

    @property
    def stderr(self) -> float:
        """Standard error of the factor."""
        return self.factor * self.log_error

    @property
    def values(self) -> dict[str, float]:
        """The constants as they were found, Pa."""
        return {name: self.factor * value for name, value in self.constants.items()}

    def interval(self, value: float) -> tuple[float, float]:
        """Of a constant that the model has with this value, with 95 %, in its unit."""
        return value * math.exp(self.log - WIDE * self.log_error), value * math.exp(self.log + WIDE * self.log_error)

    def record(self) -> StiffnessRecord:
        """As results hold it: constants in Pa, or those of a sheet of unknown thickness times it, in N/mm."""
        one = self.scale.factor
        rows = {
            name: StiffnessRow(
                value=self.factor * value * one,
                stderr=self.stderr * value * one,
                interval=tuple(end * one for end in self.interval(value)),
                scene=self.stated[name] * one,
                unit=self.scale.unit,
                per_thickness=self.scale.per_thickness,
            )
            for name, value in self.constants.items()
        }
        return StiffnessRecord(constants=rows)


def log_factor(shift: float, error: float, prior: float) -> tuple[float, float]:
    """Logarithm of the factor of the stiffnesses and its standard deviation.

    Args:
        shift: posterior mean of the factor minus one, with a Gaussian prior about one.
        error: its standard deviation.
        prior: standard deviation of that prior, and of the logarithm here.
    """
    precision = max(1 / error**2 - 1 / prior**2, 0.0)
    if precision * prior**2 < 1e-9:
        return 0.0, prior
    mean = 1 + shift / error**2 / precision

    def slope(log: float) -> float:
        return precision * (math.exp(log) - mean) * math.exp(log) + log / prior**2

    # Where the slope changes its sign: far below, the prior holds; far above, the likelihood does.
    low, high = min(0.0, -10 * prior), max(0.0, math.log(max(mean, 1e-300))) + 1.0
    while slope(low) > 0:
        low *= 2
    log = float(brentq(slope, low, high))
    curvature = precision * (2 * math.exp(2 * log) - mean * math.exp(log)) + 1 / prior**2
    return log, 1 / math.sqrt(max(curvature, 1 / prior**2))
