"""Effects that are real, and that the catalogue does not have: what a diagnosis must not give a wrong name to."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import ufl

from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount, Shape

# Stiffness of a sound bond and of the ball, Pa/m; a body of 15 kPa that is 10 mm thick has 1.5e6.
RIGID = 1.5e8
HARD = 3e6
# How far above the body's top the ball waits when its reach is zero, m: further than any lift.
CLEARANCE = 0.030
# Of a patch that has peeled wholly the bond keeps this part.
_LEFT = 1e-5


def _excess(point: Point, c: Constants) -> Any:
    """By what the strain exceeds the set, beyond the yield strain; a bounded measure, for corners strain without limit."""
    deviator = ufl.dev(point.kin.E)
    strain = deviator / ufl.sqrt(1 + ufl.inner(deviator, deviator)) - point.past.memory["set"]
    size = ufl.sqrt(ufl.inner(strain, strain) + 1e-20)
    return ufl.max_value(1 - c["yield_strain"] / size, 0.0) * strain


def _natural(point: Point, c: Constants) -> Any:
    shortened = ufl.Identity(3) - c["kept"] * point.past.memory["set"]
    return ufl.det(shortened) ** (-1 / 3) * shortened


permanent_set = BodyEffect(
    name="permanent_set",
    parameters=(
        Amount("kept", "1", "part of the set that the rest state takes on", lower=0.0, upper=0.9, neutral=0.0,
                  scale=0.3),
        Shape("yield_strain", "1", "strain beyond which the set follows", lower=0.0, open_lower=True, scale=0.01),
    ),
    about="strain that remains after loading, as in plasticity with linear hardening (play operator)",
    acts_on="material",
    growth=_natural,
    memory={"set": (3, 3)},
    advance=lambda point, c: {"set": point.past.memory["set"] + _excess(point, c)},
)  # fmt: skip


def _penetration(point: Point, c: Constants) -> Any:
    """How deep a point is inside the ball, m; 0 outside."""
    height = c["top"] + CLEARANCE - c["reach"] + c["radius"]
    away = point.X + point.u - ufl.as_vector((c["cx"], height, c["cz"]))
    return ufl.max_value(c["radius"] - ufl.sqrt(ufl.inner(away, away) + 1e-20), 0.0)


def _touch(point: Point, c: Constants) -> Any:
    # The whole boundary may touch, not only named places.
    surface = ufl.Measure("ds", domain=ufl.domain.extract_unique_domain(point.X), metadata={"quadrature_degree": 4})
    return HARD * _penetration(point, c) ** 2 / 2 * surface


obstacle = BodyEffect(
    name="obstacle",
    parameters=(
        Amount("reach", "m", "how far the ball comes down", lower=0.0, upper=CLEARANCE, neutral=0.0, scale=0.02),
        Shape("cx", "m", "x of its centre"),
        Shape("cz", "m", "z of its centre"),
        Shape("top", "m", "height (y) of the body's top"),
        Shape("radius", "m", "of the ball", lower=0.0, open_lower=True, scale=0.03),
    ),
    about="a rigid ball above the body, which it meets when it is lifted",
    acts_on="boundary",
    potential=_touch,
)


def _bond(point: Point, c: Constants) -> Any:
    stiffness = RIGID * ufl.exp(math.log(_LEFT) * c["peeled"])
    held = stiffness * point.anchored(point.place) * ufl.inner(point.u, point.u) / 2
    return held * point.surface(point.place)


def _letting_go(time: float, values: Mapping[str, float]) -> Mapping[str, float]:
    part = min(max((time - values["onset"]) / values["ramp"], 0.0), 1.0)
    return {**values, "peeled": values["peeled"] * part * part * (3 - 2 * part)}


peeling = BodyEffect(
    name="peeling",
    parameters=(
        Amount("peeled", "1", "how much of the bond is lost, on a logarithmic scale", lower=0.0, upper=1.0,
                  neutral=0.0, scale=0.5),
        Shape("onset", "s", "when it begins to peel"),
        Shape("ramp", "s", "how long that takes", lower=0.0, open_lower=True),
    ),
    about="an anchored patch that comes off at some time and stays off",
    acts_on="boundary",
    potential=_bond,
    acting=_letting_go,
    frees=True,
    places=lambda scene, anchors: sorted(anchors),
)  # fmt: skip

EFFECTS = {effect.name: effect for effect in (permanent_set, obstacle, peeling)}
