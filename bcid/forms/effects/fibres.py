"""Fibres: the body is stiffer along one direction of the plane of fibres.

Energy per rest volume: k1/2 (I4 - 1)^2 with I4 = a . C a the squared stretch along a = cos(angle) e1 + sin(angle) e2, the
standard reinforcing model (Qiu & Pence, J. Elasticity 49, 1997). The fibres resist compression as well as tension. e1 and
e2 are the axes of the scene's `fibre_plane`.
"""

from __future__ import annotations

from bcid.forms.effects.effect import BodyEffect
from bcid.forms.parameter import Amount, Shape

effect = BodyEffect(
    name="fibres",
    parameters=(
        Amount("k1", "Pa", "stiffness of the fibres", lower=0.0, upper=1e8, neutral=0.0, scale=2000.0),
        # (a . E a)^2 is a polynomial in cos 2a and cos 4a: five values determine it.
        Shape(
            "angle",
            "deg",
            "direction in the plane of fibres",
            default=0.0,
            lower=-180.0,
            upper=360.0,
            scale=20.0,
            scan=(0.0, 36.0, 72.0, 108.0, 144.0),
            period=180.0,
            harmonics=2,
        ),
    ),
    about="fibres make the body stiffer along one direction",
    acts_on="material",
    energy=lambda point, c: c["k1"] / 2 * point.kin.invariant4_minus_1(point.kin.direction(c["angle"])) ** 2,
)
