"""Support friction: the surface on which the body lies holds it back when it slides.

Per rest area of the scene's support a spring along the surface in series with a slider (Prandtl's element) holds the body with a
shear stress of at most tau (Pa): it sticks where it is moved by less than e = size/1000 from where it was let go, with the stress
tau |s|/e for the tangential displacement s since then, and slides beyond. The stress does not depend on the pressure (Tresca
friction) nor on how long the steps are. It opposes the motion and is not recovered on the way back, which leaves a loop between
loading and unloading. At rest it holds nothing.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects import _needs, _slider
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount

_STICKS = 1e-3


def moved(point: Point) -> tuple[Any, Any]:
    """Tangential displacement from where the body was let go, and how much of it sticks, m."""
    normal, change = point.normal(point.support), point.u - point.past.memory["held"]
    return change - ufl.inner(change, normal) * normal, _STICKS * point.size


def potential(point: Point, c: Constants) -> Any:
    """What a step stores in the springs and takes to slide."""
    along, limit = moved(point)
    cost = c["shear_stress"] * limit / 2 * _slider.work(along, limit)
    return point.past.moving * cost * point.surface(point.support)


def advance(point: Point, c: Constants) -> dict[str, Any]:
    """Where the body would be let go after a step; at step 0 where it lies."""
    along, limit = moved(point)
    slides = point.past.moving * _slider.slid(along, limit) + (1 - point.past.moving) * along
    return {"held": point.past.memory["held"] + slides}


effect = BodyEffect(
    name="support_friction",
    parameters=(Amount("shear_stress", "Pa", "shear stress while sliding", lower=0.0, neutral=0.0, scale=10.0),),
    about="the support holds the body back when it slides",
    acts_on="boundary",
    potential=potential,
    memory={"held": (3,)},
    advance=advance,
    needs=lambda scene, measurement: _needs.support(scene, measurement) or _needs.motion(scene, measurement),
)
