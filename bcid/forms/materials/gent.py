"""Gent solid: neo-Hookean at first, with a stretch that cannot be exceeded because the chains are taut.

Parameters:
    mu: initial shear modulus, Pa.
    jm: the value that I1bar - 3 approaches but never reaches; infinity would be neo-Hookean.
    poisson: Poisson's ratio nu at small strain.

Equation:
    psi = -mu jm/2 ln(1 - (I1bar - 3)/jm) + U(J), U = K/2 (ln J)^2 unless another U is chosen

Relation to known quantities:
    The bulk modulus is K = 2 mu (1 + nu) / (3 (1 - 2 nu)). An incompressible bar locks at the stretch s
    with s^2 + 2/s - 3 = jm: jm = 2 is twofold stretch, jm = 97 tenfold. Beyond the limit the energy is not a number
    and a solver has to take a smaller step.

Source:
    Gent, Rubber Chem. Technol. 69 (1996) 59.

Example:
    >>> from bcid.forms import materials
    >>> materials.law("gent").check({"mu": 5000.0, "jm": 3.0, "poisson": 0.45})
    []
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics
from bcid.forms.materials._moduli import POISSON, bulk_compliance, bulk_modulus
from bcid.forms.materials.law import Constants, Law, Scalar
from bcid.forms.parameter import Parameter


def shear(c: Constants) -> Scalar:
    """Initial shear modulus mu (Pa)."""
    return c["mu"]


def energy(kin: Kinematics, c: Constants) -> Expr:
    """-mu jm/2 ln(1 - (I1bar - 3)/jm)."""
    return -c["mu"] * c["jm"] / 2 * ufl.ln(1 - kin.I1bar_minus_3 / c["jm"])


law = Law(
    name="gent",
    title="Gent",
    parameters=(
        Parameter("mu", "Pa", "initial shear modulus", lower=0, open_lower=True),
        Parameter("jm", "1", "limit of the first invariant: I1bar - 3 stays below it", lower=0, open_lower=True),
        POISSON,
    ),
    energy=energy,
    shear=shear,
    bulk=lambda c: bulk_modulus(shear(c), c["poisson"]),
    compliance=lambda c: bulk_compliance(shear(c), c["poisson"]),
    about="Rubber-like solid that locks at a limiting stretch.",
)
