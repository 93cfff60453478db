"""Support friction: the surface on which the body lies holds it back when it slides.

Potential of a step per rest area of the scene's support: tau sqrt(|d|^2 + e^2), with the shear stress tau (Pa) and the
tangential displacement d since the last step (Tresca friction, regularised over e = size/1000: less than that counts as
creeping, more as sliding). The stress does not depend on the pressure. The force opposes the motion and is not
recovered on the way back, which leaves a loop between loading and unloading.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount

_CREEP = 1e-3


def potential(point: Point, c: Constants) -> Any:
    """What sliding costs."""
    change, edge = point.u - point.past.u, _CREEP * point.size
    slid = change - ufl.inner(change, point.N) * point.N
    cost = ufl.sqrt(ufl.inner(slid, slid) + edge**2) - edge
    return point.past.moving * c["shear_stress"] * cost * point.surface(point.support)


effect = BodyEffect(
    name="support_friction",
    parameters=(Amount("shear_stress", "Pa", "shear stress while sliding", lower=0.0, neutral=0.0, scale=10.0),),
    about="the support holds the body back when it slides",
    acts_on="boundary",
    potential=potential,
    uses_past=True,
    needs=lambda scene, measurement: _needs.support(scene, measurement) or _needs.motion(scene, measurement),
)
