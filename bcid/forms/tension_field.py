"""A sheet that wrinkles: where it is pushed together it folds, and carries next to no compression.

The energy of a sheet that may wrinkle is the least of its law's over all material that folds may hide, W(l1 s1, l2 s2, l3) with
s1, s2 >= 1 in the principal directions of its plane. It is in uniaxial tension where one of the principal stresses would be
negative, and without stress where both would be (Pipkin, IMA J. Appl. Math. 36, 1986, 85; Steigmann, Proc. R. Soc. A 429, 1990,
141).
The law sees F S with S = diag(s1, s2, 1). In logarithms u of the stretches and v of those that the law sees, with u1 >= u2,

    v1 = max(u1, -nu u3 - d),    v2 = max(u2, (-nu (v1 + u3) - d)/(1 - nu)),    d = b (1 + nu) (1 - 2 nu),

which is the least for a stress that is linear in u (Hencky). Of other isotropic laws v is off by the square of the strain, and the
energy, which is stationary there, by the square of that. With u3 a field of its own the energy is as convex as the law's; bounds
that took the width in tension from u3 alone, max(u2, u3), are the same in equilibrium and not convex on the way there.

As a thin sheet that has buckled does, it goes on to carry the small stress at which it did, b E: folds take the energy
b E ln det S. That keeps rest, and uniaxial tension, away from the corner of max, which is rounded off: there S is the identity,
and the law that of a sheet that stays flat, to the last digit.
"""

from __future__ import annotations

from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

from bcid.forms.kinematics import Kinematics, expm1
from bcid.forms.materials.law import Scalar

BUCKLING = 2e-4
"""Compressive stress b at which a sheet wrinkles, in Young's moduli. A tenth of it takes twice as many iterations."""

UNWRINKLED = 1e-3
"""Part of the sheet that stays flat. It holds regions without tension, which the stress b E alone would make unstable."""

# Least half difference of principal strains: directions have a slope where both are the same. It changes nothing of a flat sheet.
_APART = 1e-4


@dataclass(frozen=True)
class TensionField:
    """A sheet in a plane z = const that wrinkles; build it with `TensionField.of`.

    Attributes:
        kin: the deformation of the folded material, which the law sees.
        folding: energy that folds take, Pa, per rest volume.
    """

    kin: Kinematics
    folding: Expr

    @classmethod
    def of(cls, flat: Kinematics, modulus: Scalar, poisson: Scalar) -> TensionField:
        """The sheet whose middle plane and thickness deform as those of a flat one.

        Args:
            flat: its deformation.
            modulus: shear modulus of the law at small strain, Pa.
            poisson: its Poisson's ratio at small strain.
        """
        E = flat.E
        mean, half, slide = (E[0, 0] + E[1, 1]) / 2, (E[0, 0] - E[1, 1]) / 2, E[0, 1]
        radius = ufl.sqrt(half**2 + slide**2 + _APART**2)
        u1, u2, u3 = (ufl.ln(1 + 2 * strain) / 2 for strain in (mean + radius, mean - radius, E[2, 2]))
        least = BUCKLING * (1 + poisson) * (1 - 2 * poisson)
        first = _hidden(u1, -poisson * u3 - least, least / 2)
        second = _hidden(u2, (-poisson * (u1 + first + u3) - least) / (1 - poisson), least / 2)
        s1, s2 = expm1(first), expm1(second)
        alike, apart = (s1 + s2) / 2, (s1 - s2) / (2 * radius)
        folds = ufl.as_matrix(
            [[alike + apart * half, apart * slide, 0], [apart * slide, alike - apart * half, 0], [0, 0, 0]]
        )
        gradient = flat.H + flat.F * folds
        kin = Kinematics(gradient, ufl.Identity(3) + gradient, flat.axes)
        return cls(kin, BUCKLING * 2 * modulus * (1 + poisson) * (first + second))


def _hidden(u: Expr, least: Expr, width: Scalar) -> Expr:
    """max(u, least) - u, rounded off over a width to both sides of the corner; its second derivative is continuous."""
    t = (u - least) / width
    inside = ufl.max_value(-1.0, ufl.min_value(t, 1.0))
    return width * ((1 - inside) ** 3 * (3 + inside) / 16 + ufl.max_value(-1.0 - t, 0.0))
