"""Roller: a place of the scene does not move along its normal, and slides across it.

Potential: k/2 (u . N)^2 per rest area of the place, with the outward normal N of the body at rest. The stiffness k (Pa/m) stands
for a rigid contact that neither lifts nor rubs. It is how a scene's [held] holds a surface with along = "normal".
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount

# Far stiffer than tissue of any size that is handled: 1 kPa press it in by 10 nm.
RIGID = 1e11


def potential(point: Point, c: Constants) -> Any:
    """Energy of the springs."""
    return c["stiffness"] / 2 * ufl.inner(point.u, point.N) ** 2 * point.surface(point.place)


effect = BodyEffect(
    name="roller",
    parameters=(
        Amount(
            "stiffness", "Pa/m", "force per area and displacement along the normal", lower=0.0, neutral=0.0, scale=3e4
        ),
    ),
    about="a place does not move along its normal",
    acts_on="boundary",
    potential=potential,
    places=lambda scene, _anchors: list(scene.places),
    only_named=True,
)
