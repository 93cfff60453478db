"""Saint Venant-Kirchhoff solid: Hooke's law in the Green-Lagrange strain, for large rotations at small strain.

Parameters:
    young: Young's modulus E, Pa.
    poisson: Poisson's ratio nu, below 0.5.

Equation:
    psi = mu E:E + lambda/2 (tr E)^2, with E = (C - I)/2

Relation to known quantities:
    mu = E / (2 (1 + nu)), lambda = E nu / ((1 + nu) (1 - 2 nu)). The law softens in compression and collapses at a
    uniaxial stretch of 1/sqrt(3) = 0.58: do not use it where the body is squeezed by more than about 20 %. The energy
    is complete, so there is no mixed form.

Source:
    Holzapfel, Nonlinear Solid Mechanics (2000), eq. 6.151.

Example:
    >>> from bcid.forms import materials
    >>> materials.law("saint_venant_kirchhoff").check({"young": 15e3, "poisson": 0.35})
    []
"""

from __future__ import annotations

from dataclasses import replace

import ufl
from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics
from bcid.forms.materials._moduli import POISSON, YOUNG, first_lame, shear_modulus
from bcid.forms.materials.law import Constants, Law, Scalar


def shear(c: Constants) -> Scalar:
    """Shear modulus mu (Pa)."""
    return shear_modulus(c["young"], c["poisson"])


def energy(kin: Kinematics, c: Constants) -> Expr:
    """mu E:E + lambda/2 (tr E)^2."""
    mu = shear(c)
    return mu * ufl.inner(kin.E, kin.E) + first_lame(mu, c["poisson"]) / 2 * ufl.tr(kin.E) ** 2


law = Law(
    name="saint_venant_kirchhoff",
    title="Saint Venant-Kirchhoff",
    parameters=(YOUNG, replace(POISSON, about="Poisson's ratio", open_upper=True)),
    energy=energy,
    shear=shear,
    about="Hooke's law with large rotations; for small strains only.",
)
