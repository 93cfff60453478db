"""Layer: a skin on the body, stiffer than what is below it.

An incompressible neo-Hookean membrane on the whole boundary, which does not resist bending: with the surface's stretch tensor
Cs = P C P, P = 1 - N N', and its ratio of areas Js = |cof F N|, the energy per rest area is

    g/2 (tr Cs + 1/Js^2 - 3),

where g (N/m) is the skin's shear modulus times its thickness (elastic surfaces: Gurtin & Murdoch, Arch. Ration. Mech. Anal. 57,
1975; Steigmann & Ogden, Proc. R. Soc. A 453, 1997).
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount


def potential(point: Point, c: Constants) -> Any:
    """Energy of the skin."""
    kin, normal = point.kin, point.N
    trace = ufl.tr(kin.C) - ufl.inner(normal, kin.C * normal)
    areas = kin.J**2 * ufl.inner(normal, ufl.inv(kin.C) * normal)
    return c["stiffness"] / 2 * (trace + 1 / areas - 3) * point.boundary


effect = BodyEffect(
    name="layer",
    parameters=(
        Amount("stiffness", "N/m", "shear modulus of the skin times its thickness", lower=0.0, neutral=0.0, scale=50.0),
    ),
    about="a skin on the body is stiffer than what is below it",
    acts_on="boundary",
    wrinkles=False,
    only_named=True,
    potential=potential,
)
