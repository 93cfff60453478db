"""Effects that are real, and that the catalogue does not have: what a diagnosis must not give a wrong name to."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import ufl

from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount, Shape


def _vector(c: Constants, *names: str) -> Any:
    return ufl.as_vector([c[name] for name in names])


def _bump(square: Any) -> Any:
    """1 at none, falling smoothly; of the square of a distance in its own unit."""
    return ufl.exp(-square)


# -- somebody else pulls at the body for a while
# ------------------------------------------------------------------------------------------------------------------


def _pulled(point: Point, c: Constants) -> Any:
    away = point.X - _vector(c, "cx", "cy", "cz")
    near = _bump(ufl.inner(away, away) / c["radius"] ** 2)
    return -c["pull"] * near * ufl.inner(_vector(c, "dx", "dy", "dz"), point.u)


def _for_a_while(time: float, values: Mapping[str, float]) -> Mapping[str, float]:
    part = (time - values["start"]) / values["seconds"]
    return {**values, "pull": values["pull"] * (math.sin(math.pi * part) ** 2 if 0 < part < 1 else 0.0)}


second_grasp = BodyEffect(
    name="second_grasp",
    parameters=(
        Amount("pull", "N/m^3", "force per rest volume in the middle", lower=0.0, neutral=0.0, scale=2e4),
        *(Shape(f"c{axis}", "m", f"{axis} of the middle") for axis in "xyz"),
        Shape("radius", "m", "length over which it falls by e", lower=0.0, open_lower=True, scale=0.01),
        *(Shape(f"d{axis}", "1", f"direction, {axis}") for axis in "xyz"),
        Shape("start", "s", "when it begins"),
        Shape("seconds", "s", "how long it takes", lower=0.0, open_lower=True),
    ),
    about="a second gripper pulls at the body for a while, and is not told of",
    energy=_pulled,
    acting=_for_a_while,
)


# -- one side grows while the other shrinks
# ------------------------------------------------------------------------------------------------------------------


def _warmer(point: Point, c: Constants) -> Any:
    across = ufl.inner(_vector(c, "dx", "dy", "dz"), point.X - point.centre) / point.size
    return ufl.exp(-c["rate"] * across) * ufl.Identity(3)


warming = BodyEffect(
    name="warming",
    parameters=(
        Amount("rate", "1/s", "growth of lengths per time and size", lower=-0.1, upper=0.1, neutral=0.0, scale=1e-3),
        *(Shape(f"d{axis}", "1", f"direction, {axis}") for axis in "xyz"),
    ),
    about="one side grows with time while the other shrinks, as in a gradient of temperature",
    acts_on="material",
    growth=_warmer,
    acting=lambda time, values: {**values, "rate": values["rate"] * time},
)


# -- a cut opens
# ------------------------------------------------------------------------------------------------------------------


def _torn(point: Point, c: Constants) -> Any:
    radians = c["angle"] * (math.pi / 180)
    away = point.X - _vector(c, "cx", "cy", "cz")
    across = ufl.cos(radians) * away[0] + ufl.sin(radians) * away[2]
    along = ufl.cos(radians) * away[2] - ufl.sin(radians) * away[0]
    return 1 - c["torn"] * _bump((across / c["width"]) ** 2 + (along / c["length"]) ** 4)


def _from_then_on(time: float, values: Mapping[str, float]) -> Mapping[str, float]:
    part = min(max((time - values["onset"]) / values["ramp"], 0.0), 1.0)
    return {**values, "torn": values["torn"] * part * part * (3 - 2 * part)}


tear = BodyEffect(
    name="tear",
    parameters=(
        Amount("torn", "1", "part of the stiffness that is lost in the band", lower=0.0, upper=0.98, neutral=0.0,
                  scale=0.5),
        *(Shape(f"c{axis}", "m", f"{axis} of the middle") for axis in "xyz"),
        Shape("width", "m", "half of the band's width", lower=0.0, open_lower=True, scale=0.005),
        Shape("length", "m", "half of its length", lower=0.0, open_lower=True, scale=0.02),
        Shape("angle", "deg", "of its normal, from x towards z"),
        Shape("onset", "s", "when it begins"),
        Shape("ramp", "s", "how long it takes", lower=0.0, open_lower=True),
    ),
    about="a narrow band tears at some time and stays torn",
    acts_on="material",
    stiffness=_torn,
    acting=_from_then_on,
)  # fmt: skip

EFFECTS = {effect.name: effect for effect in (second_grasp, warming, tear)}
