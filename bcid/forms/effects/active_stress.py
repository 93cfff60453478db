"""Active stress: the body contracts by itself along one direction of the plane of fibres.

Energy per rest volume: amplitude/2 (I4 - 1), that is a second Piola-Kirchhoff stress amplitude a x a along the fibres
a = cos(angle) e1 + sin(angle) e2 (Nash & Panfilov, Prog. Biophys. Mol. Biol. 85, 2004). With a period (s) other than 0 the
amplitude is multiplied by sin^2(pi t/period): at rest at t = 0, in full half a period later. e1 and e2 are the axes of the
scene's `fibre_plane`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from bcid.forms.effects._direction import angle
from bcid.forms.effects.effect import BodyEffect
from bcid.forms.parameter import Amount, Shape


def acting(time: float, values: Mapping[str, float]) -> Mapping[str, float]:
    """The part of the amplitude that acts at a time (s)."""
    period = values["period"]
    return {**values, "amplitude": values["amplitude"] * math.sin(math.pi * time / period) ** 2} if period else values


effect = BodyEffect(
    name="active_stress",
    parameters=(
        Amount(
            "amplitude",
            "Pa",
            "fibre stress; positive contracts",
            lower=-1e7,
            upper=1e7,
            neutral=0.0,
            scale=500.0,
        ),
        # The stress is a polynomial in cos 2a: three values determine it.
        angle(harmonics=1),
        Shape(
            "period", "s", "of the contraction; 0 is steady", default=0.0, lower=0.0, scale=2.0, scan=(0.0,), off=0.0
        ),
    ),
    about="the body contracts by itself along one direction",
    acts_on="material",
    wrinkles=False,
    energy=lambda point, c: c["amplitude"] / 2 * point.kin.invariant4_minus_1(point.kin.direction(c["angle"])),
    acting=acting,
)
