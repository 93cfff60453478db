"""Holzapfel-Gasser-Ogden solid: a soft ground substance with two families of fibres that only resist being stretched.

Parameters:
    mu: shear modulus of the ground substance, Pa.
    k1: stiffness of each fibre family, Pa.
    k2: how sharply the fibres stiffen.
    angle: the families lie in the plane of fibres, at +angle and -angle degrees; at 0 and 90 they coincide.
    kappa: dispersion of the fibre directions, from 0 (perfectly aligned) to 1/3 (isotropic).
    poisson: Poisson's ratio nu of the ground substance at small strain.

Equation:
    psi = mu/2 (I1bar - 3) + sum over both families of k1/(2 k2) (exp(k2 g) - 1) + U(J),
    U = K/2 (ln J)^2 unless another U is chosen,
    g = <e>^2 (1 - (1 - t)^3), t = min(<e>/0.01, 1), e = kappa (I1 - 3) + (1 - 3 kappa) (I4 - 1), <e> = max(e, 0)

    In the source g is <e>^2, whose second derivative jumps at e = 0; here it rises from zero while e grows to 0.01
    (0.5 % stretch) and nothing changes beyond: energy, stress and tangent are continuous, and g is convex. As Nolan
    et al. found necessary for bodies that are not incompressible, e uses the invariants of the whole deformation and
    not of its isochoric part; the source's law is recovered as the body becomes incompressible.

Relation to known quantities:
    mu is the initial shear modulus (at rest the fibres carry nothing), K = 2 mu (1 + nu) / (3 (1 - 2 nu)). A stretch
    of aligned fibres by 1 % adds about 4 k1 to the tangent stiffness along each family.

Source:
    Gasser, Ogden & Holzapfel, J. R. Soc. Interface 3 (2006) 15; Nolan et al., J. Mech. Behav. Biomed. Mater. 39
    (2014) 48.

Example:
    >>> from bcid.forms import materials
    >>> values = {"mu": 3e3, "k1": 5e3, "k2": 2.0, "angle": 30.0, "kappa": 0.1, "poisson": 0.45}
    >>> materials.law("holzapfel_gasser_ogden").check(values)
    []
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics, expm1
from bcid.forms.materials._moduli import POISSON, bulk_compliance, bulk_modulus
from bcid.forms.materials.law import Constants, Law, Scalar
from bcid.forms.parameter import Amount, Parameter

ENGAGED = 0.01
"""Fibre strain e beyond which a fibre bears its full load."""


def shear(c: Constants) -> Scalar:
    """Shear modulus of the ground substance (Pa)."""
    return c["mu"]


def energy(kin: Kinematics, c: Constants) -> Expr:
    """mu/2 (I1bar - 3) + sum over both families of k1/(2 k2) (exp(k2 g) - 1)."""
    families = (kin.direction(c["angle"]), kin.direction(-c["angle"]))
    fibres = sum(expm1(c["k2"] * _engaged_square(_fibre_strain(kin, c, a))) for a in families)
    return c["mu"] / 2 * kin.I1bar_minus_3 + c["k1"] / (2 * c["k2"]) * fibres


def _fibre_strain(kin: Kinematics, c: Constants, a: Expr) -> Expr:
    kappa = c["kappa"]
    return kappa * kin.I1_minus_3 + (1 - 3 * kappa) * kin.invariant4_minus_1(a)


def _engaged_square(strain: Expr) -> Expr:
    """<e>^2, rising smoothly from zero over 0 < e < ENGAGED."""
    tension = ufl.max_value(strain, 0.0)
    slack = 1 - ufl.min_value(tension / ENGAGED, 1.0)
    return tension**2 * (1 - slack**3)


law = Law(
    name="holzapfel_gasser_ogden",
    title="Holzapfel-Gasser-Ogden",
    parameters=(
        Parameter("mu", "Pa", "shear modulus of the ground substance", lower=0, open_lower=True),
        Amount("k1", "Pa", "stiffness of each fibre family", lower=0, neutral=0),
        Parameter("k2", "1", "how sharply the fibres stiffen", lower=0, open_lower=True),
        Parameter(
            "angle",
            "deg",
            "the families lie at + and - this angle in the plane of fibres",
            lower=-180,
            upper=180,
            scale=10,
        ),
        Parameter("kappa", "1", "dispersion of the fibre directions", default=0, lower=0, upper=1 / 3, scale=0.05),
        POISSON,
    ),
    energy=energy,
    shear=shear,
    bulk=lambda c: bulk_modulus(shear(c), c["poisson"]),
    compliance=lambda c: bulk_compliance(shear(c), c["poisson"]),
    isotropic=False,
    about="Soft tissue with two families of collagen fibres that bear load in tension only.",
)
