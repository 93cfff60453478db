"""Obstacle: a rigid ball that the body runs into as it moves, without friction; a large one is nearly a plane.

Potential per rest area of the whole boundary: k times the integral of g+, with the penetration g = r - |x - c| of the ball of
centre c and radius r by the moved point x, and its positive part smoothed as in `support_contact`. The penalty stiffness k (Pa/m)
is that of the ball's surface: the body sinks in by pressure/k.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects import _needs
from bcid.forms.effects._penalty import stored
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount, Shape

# Keeps the derivative of a distance finite at none, as part of the body's size.
_TINY = 1e-9


def potential(point: Point, c: Constants) -> Any:
    """Energy of the penalty."""
    away = point.X + point.u - ufl.as_vector([c["cx"], c["cy"], c["cz"]])
    distance = ufl.sqrt(ufl.inner(away, away) + (_TINY * point.size) ** 2)
    return c["stiffness"] * stored(c["radius"] - distance, point.size) * point.boundary


effect = BodyEffect(
    name="obstacle",
    parameters=(
        Amount("stiffness", "Pa/m", "pressure per penetration", lower=0.0, neutral=0.0, scale=1e5),
        *(Shape(f"c{axis}", "m", f"centre, {axis}", scale=0.02) for axis in "xyz"),
        Shape("radius", "m", "radius", lower=0.0, open_lower=True, scale=0.02),
    ),
    about="a rigid ball is in the way of the body",
    acts_on="boundary",
    potential=potential,
    ahead=True,
    needs=_needs.motion,
)
