"""Inclusion: a round part of the body is stiffer or softer than the rest.

The law's energy is multiplied by 1 + (ratio - 1) w with w = 1/(1 + exp((|X - c| - radius)/(0.1 radius))), which falls
from 1 to 0 at the distance radius (m) from the centre c (m, coordinates of the scene). The mesh is not fitted to it:
elements should not be much larger than the radius. Where it is must be given; a scan tries places in the body and radii
of 0.1 to 0.3 of its size.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects.effect import Constants, Effect, Point
from bcid.forms.parameter import Parameter

_EDGE = 0.1


def stiffness(point: Point, c: Constants) -> Any:
    """Factor of the strain energy."""
    away = point.X - ufl.as_vector([c["cx"], c["cy"], c["cz"]])
    beyond = (ufl.sqrt(ufl.inner(away, away)) - c["radius"]) / (_EDGE * c["radius"])
    # 1/(1 + exp x) without the overflow of exp.
    inside = (1 - ufl.tanh(beyond / 2)) / 2
    return 1 + (c["ratio"] - 1) * inside


effect = Effect(
    name="inclusion",
    parameters=(
        Parameter("ratio", "1", "its stiffness to that of the body", lower=0.02, upper=50.0, neutral=1.0, typical=1.0),
        *(Parameter(f"c{axis}", "m", f"centre, {axis}", typical=0.02) for axis in "xyz"),
        Parameter("radius", "m", "radius", lower=0.0, open_lower=True, typical=0.02),
    ),
    about="a round part of the body is stiffer or softer",
    acts_on="material",
    stiffness=stiffness,
)
