"""Compressible neo-Hookean solid: the simplest law that stays sound at large rotation and stretch.

Parameters:
    young: Young's modulus E at small strain, Pa.
    poisson: Poisson's ratio nu at small strain.

Equation:
    psi = mu/2 (I1 - 3 - 2 ln J) + U(J), U = lambda/2 (ln J)^2 unless another U is chosen

Relation to known quantities:
    mu = E / (2 (1 + nu)) is the shear modulus and lambda = E nu / ((1 + nu) (1 - 2 nu)) Lame's first constant; the
    bulk modulus at small strain is lambda + 2 mu / 3. The factor of U is lambda, so that the mixed form needs nu > 0.

Source:
    Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, 2nd ed. (2008), chapter 6.

Example:
    >>> from bcid.forms import materials
    >>> materials.law("neo_hooke").shear({"young": 15e3, "poisson": 0.25})
    6000.0
"""

from __future__ import annotations

from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics
from bcid.forms.materials._moduli import POISSON, YOUNG, first_lame, first_lame_compliance, shear_modulus
from bcid.forms.materials.law import Constants, Law, Scalar


def shear(c: Constants) -> Scalar:
    """Shear modulus mu (Pa)."""
    return shear_modulus(c["young"], c["poisson"])


def energy(kin: Kinematics, c: Constants) -> Expr:
    """mu/2 (I1 - 3 - 2 ln J)."""
    return shear(c) / 2 * (kin.I1_minus_3 - 2 * kin.lnJ)


law = Law(
    name="neo_hooke",
    title="Neo-Hookean",
    parameters=(YOUNG, POISSON),
    energy=energy,
    shear=shear,
    bulk=lambda c: first_lame(shear(c), c["poisson"]),
    compliance=lambda c: first_lame_compliance(shear(c), c["poisson"]),
    about="Two-constant rubber-like solid; the default for soft tissue at moderate stretch.",
)
