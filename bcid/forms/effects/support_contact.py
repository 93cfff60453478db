"""Support contact: the body cannot sink into the surface on which it lies, but may lift off.

Potential per rest area of the scene's support: k times the integral of g+, with the penetration g = u . N (N: outward
normal in the rest state, so the support is taken to be flat) and its positive part g+, which is 0 up to g = 0, then
g^2/(2 e), and g - e/2 from g = e on, e = size/1000. So there is neither force nor stiffness before they touch, and the
tangent is continuous. The penalty stiffness k (Pa/m) is that of the support; let it be small against a rigid one: the
body sinks in by pressure/k.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects import _needs
from bcid.forms.effects._penalty import stored
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount


def potential(point: Point, c: Constants) -> Any:
    """Energy of the penalty."""
    return c["stiffness"] * stored(ufl.inner(point.u, point.N), point.size) * point.surface(point.support)


effect = BodyEffect(
    name="support_contact",
    parameters=(Amount("stiffness", "Pa/m", "pressure per penetration", lower=0.0, neutral=0.0, scale=1e5),),
    about="the body cannot sink into its support, but may lift off",
    acts_on="boundary",
    potential=potential,
    needs=_needs.support,
)
