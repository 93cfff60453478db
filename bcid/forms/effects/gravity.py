"""Gravity: the weight of the body, as a dead body force along the scene's down.

Energy per rest volume: -w d . u, with weight per rest volume w (N/m^3; density times 9.81 m/s^2) and unit vector d.
"""

from __future__ import annotations

import ufl

from bcid.forms.effects.effect import BodyEffect
from bcid.forms.parameter import Amount

effect = BodyEffect(
    name="gravity",
    parameters=(
        Amount("weight", "N/m^3", "weight per rest volume; water has 9810", lower=0.0, neutral=0.0, scale=5000.0),
    ),
    about="weight of the body along the scene's down",
    energy=lambda point, c: -c["weight"] * ufl.inner(point.down, point.u),
)
