"""Foundation: the support surface is held by springs.

Potential: k/2 (u . N)^2 per rest area of the scene's support, with the stiffness k (Pa/m) and the outward normal N in
the rest state (Winkler's foundation), in compression and in tension. With the place "sheared" the springs act in all
directions: k/2 |u|^2.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount


def potential(point: Point, c: Constants) -> Any:
    """Energy of the springs."""
    square = ufl.inner(point.u, point.u) if point.place == "sheared" else ufl.inner(point.u, point.N) ** 2
    return c["stiffness"] / 2 * square * point.surface(point.support)


effect = BodyEffect(
    name="foundation",
    parameters=(Amount("stiffness", "Pa/m", "force per area and displacement", lower=0.0, neutral=0.0, scale=3e4),),
    about="the support surface is held by springs",
    acts_on="boundary",
    potential=potential,
    places=lambda _scene, _anchors: ["", "sheared"],
    needs=_needs.support,
)
