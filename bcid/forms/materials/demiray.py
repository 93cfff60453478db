"""Demiray solid: exponential stiffening without fibres, for arteries, skin and the like.

Parameters:
    mu: initial shear modulus, Pa.
    b: how fast it stiffens; 0 would be neo-Hookean.
    poisson: Poisson's ratio nu at small strain.

Equation:
    psi = mu/(2 b) (exp(b (I1bar - 3)) - 1) + U(J), U = K/2 (ln J)^2 unless another U is chosen

Relation to known quantities:
    The bulk modulus is K = 2 mu (1 + nu) / (3 (1 - 2 nu)). The stiffness has doubled where I1bar - 3 = ln(2)/b: with b = 1
    at a stretch of 1.55 in tension of an incompressible body, with b = 8 at 1.18.

Source:
    Demiray, J. Biomech. 5 (1972) 309; with I1bar for I1, as usual where the volume may change.

Example:
    >>> from bcid.forms import materials
    >>> materials.law("demiray").check({"mu": 5000.0, "b": 1.0, "poisson": 0.45})
    []
"""

from __future__ import annotations

from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics, expm1
from bcid.forms.materials._moduli import POISSON, bulk_compliance, bulk_modulus
from bcid.forms.materials.law import Constants, Law, Scalar
from bcid.forms.parameter import Parameter


def shear(c: Constants) -> Scalar:
    """Initial shear modulus mu (Pa)."""
    return c["mu"]


def energy(kin: Kinematics, c: Constants) -> Expr:
    """mu/(2 b) (exp(b (I1bar - 3)) - 1)."""
    return c["mu"] / (2 * c["b"]) * expm1(c["b"] * kin.I1bar_minus_3)


law = Law(
    name="demiray",
    title="Demiray",
    parameters=(
        Parameter("mu", "Pa", "initial shear modulus", lower=0, open_lower=True),
        Parameter("b", "1", "stiffening: how fast the stiffness grows with I1bar - 3", lower=0, open_lower=True),
        POISSON,
    ),
    energy=energy,
    shear=shear,
    bulk=lambda c: bulk_modulus(shear(c), c["poisson"]),
    compliance=lambda c: bulk_compliance(shear(c), c["poisson"]),
    about="Soft tissue that stiffens exponentially, the same in all directions.",
)
