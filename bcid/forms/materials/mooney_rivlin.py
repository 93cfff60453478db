"""Mooney-Rivlin solid: two shear constants, for rubber and gels up to about twofold stretch.

Parameters:
    c10: constant of the first invariant, Pa.
    c01: constant of the second invariant, Pa; 0 makes it neo-Hookean.
    poisson: Poisson's ratio nu at small strain.

Equation:
    psi = c10 (I1bar - 3) + c01 (I2bar - 3) + U(J), U = K/2 (ln J)^2 unless another U is chosen

Relation to known quantities:
    The initial shear modulus is mu = 2 (c10 + c01), the bulk modulus K = 2 mu (1 + nu) / (3 (1 - 2 nu)), and Young's
    modulus 2 mu (1 + nu), which is 6 (c10 + c01) for an incompressible body. A negative c01 may fit data but loses
    stability in compression.

Source:
    Mooney, J. Appl. Phys. 11 (1940) 582; Rivlin, Phil. Trans. R. Soc. A 241 (1948) 379.

Example:
    >>> from bcid.forms import materials
    >>> materials.law("mooney_rivlin").shear({"c10": 2000.0, "c01": 500.0, "poisson": 0.45})
    5000.0
"""

from __future__ import annotations

from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics
from bcid.forms.materials._moduli import POISSON, bulk_compliance, bulk_modulus
from bcid.forms.materials.law import Constants, Law, Scalar
from bcid.forms.parameter import Amount, Parameter


def shear(c: Constants) -> Scalar:
    """Initial shear modulus 2 (c10 + c01) (Pa)."""
    return 2 * (c["c10"] + c["c01"])


def energy(kin: Kinematics, c: Constants) -> Expr:
    """c10 (I1bar - 3) + c01 (I2bar - 3)."""
    return c["c10"] * kin.I1bar_minus_3 + c["c01"] * kin.I2bar_minus_3


law = Law(
    name="mooney_rivlin",
    title="Mooney-Rivlin",
    parameters=(
        Parameter("c10", "Pa", "constant of the first invariant"),
        Amount("c01", "Pa", "constant of the second invariant", default=0, neutral=0),
        POISSON,
    ),
    energy=energy,
    shear=shear,
    bulk=lambda c: bulk_modulus(shear(c), c["poisson"]),
    compliance=lambda c: bulk_compliance(shear(c), c["poisson"]),
    about="Rubber and gels at moderate stretch.",
)
