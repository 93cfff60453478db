"""Sums over the principal stretches that stay smooth, with their derivatives, where principal stretches coincide.

A single eigenvalue has no second derivative where it meets another, and stretches always meet: all three at rest, two
in a simple pull. Sums over all three are smooth; the pieces that have no limit cancel. Here they do so in floating
point and under automatic differentiation:

    C = q (I + B), tr B = 0, eigenvalues 1 + w of C/q with w^3 - j w - b = 0, j = B:B/2, b = det B
    w = p cos(phi + 2 pi k/3), p^2 = 4 j/3, cos(3 phi) = r = 4 b/p^3          (Cardano, Viete)

p^2 gets a small constant SHIFT^2. The three numbers are then the exact roots of a cubic whose j is shifted by a
constant: they stay apart by at least about SHIFT, |r| stays below 1, every square root has a slope, and what must
cancel still does. Two eigenvalues that meet enter as m +- d through an even function of d,
(m + d)^s + (m - d)^s = 2 (m^2 - d^2)^(s/2) cosh(s atanh(d/m)). The relative error of value, stress and tangent is of
the order of SHIFT^2, the round-off of the tangent at most of the order of 1e-16/SHIFT.

The care where eigenvalues meet follows Habera & Zilian, "Symbolic spectral decomposition of 3x3 matrices" (2021),
arXiv:2111.02117, who treat the discriminant; the arrangement here is for sums and their second derivatives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics
from bcid.forms.materials.law import Scalar

SHIFT = 1e-5
"""Smallest radius p of the spectrum, relative to the mean eigenvalue."""


@dataclass(frozen=True)
class Spectrum:
    """Logarithms of the eigenvalues of a positive definite 3 x 3 tensor: largest, pair + half_gap, pair - half_gap."""

    largest: Scalar
    pair: Scalar
    half_gap: Scalar

    @classmethod
    def isochoric(cls, kin: Kinematics) -> Spectrum:
        """The spectrum of J^(-2/3) C: squared principal stretches without the change of volume."""
        mean = kin.I1 / 3
        deviator = 2 * ufl.dev(kin.E)
        j = ufl.inner(deviator, deviator) / (2 * mean**2)
        b = ufl.det(deviator) / mean**3
        return cls._of(ufl.ln(mean) - 2 / 3 * kin.lnJ, j, b)

    @classmethod
    def rest(cls) -> Spectrum:
        """The spectrum of the identity, with the same shift."""
        return cls._of(*(ufl.as_ufl(0.0),) * 3)

    @classmethod
    def _of(cls, log_mean: Scalar, j: Scalar, b: Scalar) -> Spectrum:
        p2 = 4 * j / 3 + SHIFT**2
        p = ufl.sqrt(p2)
        phi = ufl.acos(4 * b / (p * p2)) / 3
        w = p * ufl.cos(phi)
        m, d = 1 - w / 2, math.sqrt(3) / 2 * p * ufl.sin(phi)
        return cls(
            largest=log_mean + ufl.ln(1 + w),
            pair=log_mean + ufl.ln((m + d) * (m - d)) / 2,
            half_gap=ufl.ln((m + d) / (m - d)) / 2,
        )

    def power(self, s: Scalar) -> Expr:
        """Sum of the eigenvalues to the power s."""
        return ufl.exp(s * self.largest) + 2 * ufl.exp(s * self.pair) * ufl.cosh(s * self.half_gap)
