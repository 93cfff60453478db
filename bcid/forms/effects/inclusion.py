"""Inclusion: a round part of the body is stiffer or softer than the rest.

The law's energy is multiplied by 1 + (ratio - 1) w with w = 1/(1 + exp((|X - c| - radius)/(0.1 radius))), which falls
from 1 to 0 at the distance radius (m) from the centre c (m, coordinates of the scene). The mesh is not fitted to it:
elements should not be much larger than the radius. Where it is must be given; a scan tries places in the body and radii
of 0.1 to 0.3 of its size, and a fit keeps the centre in the body's bounding box and the radius below half its diagonal:
a larger ball has no side that is seen to be round.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import ufl

from bcid.forms.effects.effect import Array, BodyEffect, Constants, Point
from bcid.forms.parameter import Amount, Shape

_EDGE = 0.1
# From here on tanh is 1 to the last digit; its derivative in UFL overflows further out.
_FAR = 20.0


def inside(distance: Any, radius: Any, tanh: Callable[[Any], Any]) -> Any:
    """1 in the inclusion, 0 outside: 1/(1 + exp x) without the overflow of exp."""
    return (1 - tanh((distance - radius) / (2 * _EDGE * radius))) / 2


def stiffness(point: Point, c: Constants) -> Any:
    """Factor of the strain energy."""
    away = point.X - ufl.as_vector([c["cx"], c["cy"], c["cz"]])
    return 1 + (c["ratio"] - 1) * inside(ufl.sqrt(ufl.inner(away, away)), c["radius"], _tanh)


def _tanh(x: Any) -> Any:
    return ufl.tanh(ufl.min_value(x, _FAR))


def around(points: Array, values: Mapping[str, float]) -> Array:
    """Change of the stiffness at points (n, 3), m, per unit of the ratio."""
    centre = np.array([values[f"c{axis}"] for axis in "xyz"])
    return np.asarray(inside(np.linalg.norm(points - centre, axis=1), values["radius"], np.tanh))


effect = BodyEffect(
    name="inclusion",
    parameters=(
        Amount("ratio", "1", "its stiffness to that of the body", lower=0.02, upper=50.0, neutral=1.0, scale=1.0),
        *(Shape(f"c{axis}", "m", f"centre, {axis}", scale=0.02, within=axis) for axis in "xyz"),
        Shape("radius", "m", "radius", lower=0.0, open_lower=True, scale=0.02, within="size"),
    ),
    about="a round part of the body is stiffer or softer",
    acts_on="material",
    stiffness=stiffness,
    around=around,
)
