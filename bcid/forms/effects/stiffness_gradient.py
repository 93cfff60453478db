"""Stiffness gradient: the body is stiffer at one end than at the other.

The law's energy is multiplied by 1 + g . (X - centre)/size with the rest position X, the middle of the body's bounding
box and its diagonal (m). Where that is less than 0.05 it is 0.05, so that the body stays elastic; as no point is further
from the middle than half the diagonal, this happens only with |g| > 1.9.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount

_LEAST = 0.05


def stiffness(point: Point, c: Constants) -> Any:
    """Factor of the strain energy."""
    g = ufl.as_vector([c["gx"], c["gy"], c["gz"]])
    return ufl.max_value(1 + ufl.inner(g, point.X - point.centre) / point.size, _LEAST)


effect = BodyEffect(
    name="stiffness_gradient",
    parameters=tuple(
        Amount(
            f"g{axis}", "1", f"relative change along {axis}, per size", lower=-3.0, upper=3.0, neutral=0.0, scale=0.5
        )
        for axis in "xyz"
    ),
    about="the body is stiffer at one end than at the other",
    acts_on="material",
    stiffness=stiffness,
)
