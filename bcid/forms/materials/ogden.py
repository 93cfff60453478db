"""Ogden solid: up to three power laws in the principal stretches, for rubber and very soft tissue such as brain or fat.

Parameters:
    mu1, mu2, mu3: strengths of the terms, Pa; a term with strength 0 is absent.
    alpha1, alpha2, alpha3: exponents of the terms, not 0.
    poisson: Poisson's ratio nu at small strain.

Equation:
    psi = sum_p mu_p/alpha_p (s1^alpha_p + s2^alpha_p + s3^alpha_p - 3) + U(J),
    U = K/2 (ln J)^2 unless another U is chosen, with s_i = J^(-1/3) times the principal stretches

Relation to known quantities:
    The initial shear modulus is mu = sum_p mu_p alpha_p / 2, the bulk modulus K = 2 mu (1 + nu) / (3 (1 - 2 nu)).
    This is Ogden's own convention; programs that write 2 mu_p / alpha_p^2 have mu_p(theirs) = mu_p alpha_p / 2.
    One term with alpha = 2 is neo-Hookean with mu = mu_p; two with alpha = 2 and -2 are Mooney-Rivlin with
    c10 = mu1/2, c01 = -mu2/2. A term is stable by itself if mu_p alpha_p > 0.

Source:
    Ogden, Proc. R. Soc. A 326 (1972) 565.

Example:
    >>> from bcid.forms import materials
    >>> materials.law("ogden").shear(materials.law("ogden").complete({"mu1": 500.0, "alpha1": 8.0, "poisson": 0.45}))
    2000.0
"""

from __future__ import annotations

from collections.abc import Mapping

from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics
from bcid.forms.materials._moduli import POISSON, bulk_compliance, bulk_modulus
from bcid.forms.materials.law import Constants, Law, Scalar
from bcid.forms.parameter import Amount, Parameter
from bcid.forms.spectrum import Spectrum

TERMS = (1, 2, 3)


def shear(c: Constants) -> Scalar:
    """Initial shear modulus sum_p mu_p alpha_p / 2 (Pa)."""
    return sum(c[f"mu{p}"] * c[f"alpha{p}"] for p in TERMS) / 2


def energy(kin: Kinematics, c: Constants) -> Expr:
    """sum_p mu_p/alpha_p (tr Cbar^(alpha_p/2) - 3)."""
    stretched, rest = Spectrum.isochoric(kin), Spectrum.rest()
    return sum(_term_energy(stretched, rest, c[f"mu{p}"], c[f"alpha{p}"]) for p in TERMS)


def _term_energy(stretched: Spectrum, rest: Spectrum, mu: Scalar, alpha: Scalar) -> Expr:
    return mu / alpha * (stretched.power(alpha / 2) - rest.power(alpha / 2))


def rules(values: Mapping[str, float]) -> list[str]:
    """Exponents divide their term: 0 is not one."""
    return [f"alpha{p} = 0 is not an exponent; drop the term with mu{p} = 0" for p in TERMS if values[f"alpha{p}"] == 0]


def _term(p: int) -> tuple[Parameter, Parameter]:
    strength = 0.0 if p > 1 else None
    return (
        Amount(f"mu{p}", "Pa", f"strength of term {p}", default=strength, neutral=0),
        Parameter(f"alpha{p}", "1", f"exponent of term {p}, not 0", default=None if p == 1 else 2.0),
    )


law = Law(
    name="ogden",
    title="Ogden",
    parameters=(*_term(1), *_term(2), *_term(3), POISSON),
    energy=energy,
    shear=shear,
    bulk=lambda c: bulk_modulus(shear(c), c["poisson"]),
    compliance=lambda c: bulk_compliance(shear(c), c["poisson"]),
    about="Power laws in the principal stretches, for rubber and very soft tissue.",
    rules=rules,
)
