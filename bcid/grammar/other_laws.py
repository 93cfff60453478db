"""Families of energies that take the place of the scene's law, as a part of the shear modulus or as all of it.

Their forms differ from that of the law at every strain, so that no term which only adds to it can make them: powers of the
principal stretches (Ogden, Proc. R. Soc. A 326 (1972) 565), and the exponential of a quadratic form of Green's strain
(Guccione, McCulloch & Waldman, J. Biomech. Eng. 113 (1991) 42). The shear modulus at small strain is that of the law; what
they take away of it says `bcid.grammar.replaced_law`.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from bcid.forms.parameter import Shape
from bcid.grammar.deformed import Deformed
from bcid.grammar.energies import AXIS, RATE, TURNED, UNKNOWN, coefficient, directions
from bcid.grammar.family import Family, Values
from bcid.grammar.replaced_law import APART, ReplacedLaw

Array = NDArray[np.float64]
# Exponents that are tried. A rate is tried that is as good as none: in a body that is soft without it a steep exponential seems to
# do far more than it will, and from the mildest a fit gets to the others.
_POWERS, _MILD = (3.0, 6.0, 12.0), 0.3
# Resistance to stretch and to shear along a direction that are tried, relative to those across it.
_ALONG = ((1.0, 0.5), (1.0, 2.0), (2.0, 0.6), (2.0, 1.5), (4.0, 1.0))
# Smallest and largest exponent, without their sign: 0 is none.
_LEAST, _MOST = 0.5, 40.0
# A notable part of the law.
_SHARE = 0.5


def other_laws(shear: float, law: ReplacedLaw = APART) -> list[Family]:
    """All families, for a body of this shear modulus, Pa, in the place of a part of its law."""
    laws = [_principal(shear, law, 1.0), _principal(shear, law, -1.0), _strain_exponential(shear, law)]
    return [*laws, _apart(shear, law)] if law.coupled else laws


def _apart(shear: float, law: ReplacedLaw) -> Family:
    def unit(d: Deformed, values: Values) -> Array:
        return np.asarray((d.first_slope / 2 - law.slope(d))[..., None])

    return Family(
        "first_apart", "energy", "distortion stores energy apart from the change of volume", f"c ((I1bar - 3)/2 - {law.text})",
        f"return c['c'] * (point.kin.I1bar_minus_3 / 2 - {law.code})", (coefficient(_SHARE * shear),), (), unit,
        polyconvex=UNKNOWN, instead_of="law",
    )  # fmt: skip


def _principal(shear: float, law: ReplacedLaw, sign: float) -> Family:
    longest = sign > 0
    lower, upper = (_LEAST, _MOST) if longest else (-_MOST, -_LEAST)
    power = Shape("power", "1", "exponent", default=sign * _POWERS[0], lower=lower, upper=upper, scale=2.0)

    def unit(d: Deformed, values: Values) -> Array:
        exponent = values["power"]
        return np.asarray((2 / exponent**2 * d.power_slope(exponent) - law.slope(d))[..., None])

    code = (
        "half = c['power'] / 2",
        "powers = Spectrum.isochoric(point.kin).power(half) - Spectrum.rest().power(half)",
        f"return c['c'] * (2 * powers / c['power'] ** 2 - {law.code})",
    )
    name, which = ("longest_stretch", "longest") if longest else ("shortest_stretch", "shortest")
    return Family(
        name, "energy", f"the body gets stiffer with its {which} principal stretch, in the place of the first invariant",
        f"c (2 (s1^power + s2^power + s3^power - 3) / power^2 - {law.text}) with the isochoric principal stretches s",
        "\n".join(code), (coefficient(_SHARE * shear),), (power,), unit, scans=tuple({"power": sign * p} for p in _POWERS),
        polyconvex="polyconvex for exponents from 2 on and c up to the shear modulus" if longest else UNKNOWN,
        instead_of="law",
    )  # fmt: skip


def _strain_exponential(shear: float, law: ReplacedLaw) -> Family:
    ratios = (
        Shape("along", "1", "resistance to stretch along the direction, relative to across it", 2.0, 0.0, 50.0, scale=1.0),
        Shape("sliding", "1", "resistance to shear along the direction, relative to across it", 1.0, 0.02, 20.0, scale=0.5),
    )  # fmt: skip

    def unit(d: Deformed, values: Values) -> Array:
        rate, along, sliding = (values[name] for name in ("rate", "along", "sliding"))
        a, strain = d.direction(values["azimuth"], values["elevation"]), (d.C - np.eye(3)) / 2
        pulled = strain @ a
        stretch, mixed = pulled @ a, pulled[:, :, None] * a
        plain, sheared = np.einsum("qij,qij->q", strain, strain), np.einsum("qi,qi->q", pulled, pulled)
        form = plain + (along + 1 - 2 * sliding) * stretch**2 + 2 * (sliding - 1) * sheared
        slope = 2 * strain + 2 * (along + 1 - 2 * sliding) * stretch[:, None, None] * np.outer(a, a)
        slope += 2 * (sliding - 1) * (mixed + np.swapaxes(mixed, 1, 2))
        grown = 3 / (1 + 2 * sliding) * np.exp(np.minimum(rate * form, 50.0))
        instead = law.slope(d) + (2 / 3 * np.log(d.J) / d.J)[:, None, None] * d.volume_slope
        return np.asarray((d.F @ (grown[:, None, None] * slope) - instead)[..., None])

    code = (
        *AXIS,
        "strain = point.kin.E",
        "pulled = strain * a",
        "along = ufl.inner(a, pulled) ** 2",
        "sliding = ufl.inner(pulled, pulled) - along",
        "around = ufl.inner(strain, strain) - along - 2 * sliding",
        "form = c['along'] * along + around + 2 * c['sliding'] * sliding",
        "whole = 3 / (c['rate'] * (1 + 2 * c['sliding'])) * (ufl.exp(c['rate'] * form) - 1)",
        f"return c['c'] * (whole - {law.code} - point.kin.lnJ**2 / 3)",
    )
    scans = tuple(
        where | {"rate": _MILD, "along": along, "sliding": sliding}
        for where, (along, sliding) in itertools.product(directions(), _ALONG)
    )
    return Family(
        "strain_exponential", "energy", "the body gets stiffer exponentially, and along one direction otherwise than across it",
        f"c (3 (exp(rate Q) - 1) / (rate (1 + 2 sliding)) - {law.text} - (ln J)^2/3), Q = along Eaa^2 + Ebb^2 + Ecc^2 + "
        "2 Ebc^2 + 2 sliding (Eab^2 + Eac^2) with Green's strain E, a the direction", "\n".join(code),
        (coefficient(_SHARE * shear),), (*TURNED, RATE, *ratios), unit, scans=scans, polyconvex=UNKNOWN, instead_of="law",
    )  # fmt: skip
