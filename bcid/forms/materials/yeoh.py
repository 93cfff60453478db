"""Yeoh solid: a cubic in the first invariant, for materials that stiffen as they are stretched.

Parameters:
    c1: half the initial shear modulus, Pa.
    c2: stiffening (or, if negative, softening) at moderate stretch, Pa.
    c3: stiffening at large stretch, Pa.
    poisson: Poisson's ratio nu at small strain.

Equation:
    psi = c1 (I1bar - 3) + c2 (I1bar - 3)^2 + c3 (I1bar - 3)^3 + U(J), U = K/2 (ln J)^2 unless another U is chosen

Relation to known quantities:
    The initial shear modulus is mu = 2 c1, the bulk modulus K = 2 mu (1 + nu) / (3 (1 - 2 nu)). In simple shear by an
    amount g the tangent modulus is 2 c1 + 12 c2 g^2 + 30 c3 g^4.

Source:
    Yeoh, Rubber Chem. Technol. 66 (1993) 754.

Example:
    >>> from bcid.forms import materials
    >>> materials.law("yeoh").shear({"c1": 2500.0, "c2": 400.0, "c3": 0.0, "poisson": 0.45})
    5000.0
"""

from __future__ import annotations

from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics
from bcid.forms.materials._moduli import POISSON, bulk_compliance, bulk_modulus
from bcid.forms.materials.law import Constants, Law, Scalar
from bcid.forms.parameter import Amount, Parameter


def shear(c: Constants) -> Scalar:
    """Initial shear modulus 2 c1 (Pa)."""
    return 2 * c["c1"]


def energy(kin: Kinematics, c: Constants) -> Expr:
    """c1 x + c2 x^2 + c3 x^3 with x = I1bar - 3."""
    x = kin.I1bar_minus_3
    return x * (c["c1"] + x * (c["c2"] + x * c["c3"]))


law = Law(
    name="yeoh",
    title="Yeoh",
    parameters=(
        Parameter("c1", "Pa", "half the initial shear modulus"),
        Amount("c2", "Pa", "stiffening at moderate stretch", default=0, neutral=0),
        Amount("c3", "Pa", "stiffening at large stretch", default=0, neutral=0),
        POISSON,
    ),
    energy=energy,
    shear=shear,
    bulk=lambda c: bulk_modulus(shear(c), c["poisson"]),
    compliance=lambda c: bulk_compliance(shear(c), c["poisson"]),
    about="Rubber and soft tissue that stiffen with stretch.",
)
