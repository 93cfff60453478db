"""Elastic moduli from one another; every function takes numbers as well as UFL expressions.

A compliance is the inverse of its modulus, written as a fraction of its own: at poisson = 0.5 it is exactly zero and
can still be differentiated, where 1/modulus would be 1/inf with a derivative that is not a number.
"""

from __future__ import annotations

from bcid.forms.materials.law import Scalar
from bcid.forms.parameter import Parameter

YOUNG = Parameter("young", "Pa", "Young's modulus at small strain", lower=0, open_lower=True)
POISSON = Parameter(
    "poisson",
    "1",
    "Poisson's ratio at small strain; 0.5 is incompressible and needs the mixed formulation",
    lower=-1,
    open_lower=True,
    upper=0.5,
    scale=0.1,
)


def shear_modulus(young: Scalar, poisson: Scalar) -> Scalar:
    """Shear modulus mu = E / (2 (1 + nu))."""
    return young / (2 * (1 + poisson))


def first_lame(shear: Scalar, poisson: Scalar) -> Scalar:
    """Lame's first constant lambda = 2 mu nu / (1 - 2 nu)."""
    return 2 * shear * poisson / (1 - 2 * poisson)


def first_lame_compliance(shear: Scalar, poisson: Scalar) -> Scalar:
    """1/lambda = (1 - 2 nu) / (2 mu nu)."""
    return (1 - 2 * poisson) / (2 * shear * poisson)


def bulk_modulus(shear: Scalar, poisson: Scalar) -> Scalar:
    """Bulk modulus K = 2 mu (1 + nu) / (3 (1 - 2 nu))."""
    return 2 * shear * (1 + poisson) / (3 * (1 - 2 * poisson))


def bulk_compliance(shear: Scalar, poisson: Scalar) -> Scalar:
    """1/K = 3 (1 - 2 nu) / (2 mu (1 + nu))."""
    return 3 * (1 - 2 * poisson) / (2 * shear * (1 + poisson))
