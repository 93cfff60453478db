"""Magnetic force: a body filled with magnetic particles is drawn along x towards a magnet.

Force per rest volume: strength exp((x - position)/decay) along x, at the present place x = X + u: strength (N/m^3) where
x = position (m), less by a factor of e every `decay` (m) away from it. It has the potential -strength decay
exp((x - position)/decay) per rest volume (J/m^3).
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount, Shape


def energy(point: Point, c: Constants) -> Any:
    """Potential per rest volume."""
    x = point.X[0] + point.u[0]
    return -c["strength"] * c["decay"] * ufl.exp((x - c["position"]) / c["decay"])


effect = BodyEffect(
    name="magnetic_force",
    parameters=(
        Amount("strength", "N/m^3", "force per rest volume at the position", lower=0.0, neutral=0.0, scale=5000.0),
        Shape("position", "m", "x of the place of that strength", default=0.1, scale=0.02),
        Shape(
            "decay",
            "m",
            "length over which it falls by e",
            default=0.05,
            lower=0.0,
            open_lower=True,
            scale=0.02,
            scan=(0.03, 0.1),
        ),
    ),
    about="magnetic particles draw the body towards a magnet",
    energy=energy,
)
