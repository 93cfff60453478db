"""Fibres: the body is stiffer along one direction of the plane of fibres.

Energy per rest volume: k1/2 (I4 - 1)^2 with I4 = a . C a the squared stretch along a = cos(angle) e1 + sin(angle) e2, the
standard reinforcing model (Qiu & Pence, J. Elasticity 49, 1997). The fibres resist compression as well as tension. e1 and
e2 are the axes of the scene's `fibre_plane`.
"""

from __future__ import annotations

from bcid.forms.effects._direction import angle
from bcid.forms.effects.effect import BodyEffect
from bcid.forms.parameter import Amount

effect = BodyEffect(
    name="fibres",
    parameters=(
        Amount("k1", "Pa", "stiffness of the fibres", lower=0.0, upper=1e8, neutral=0.0, scale=2000.0),
        # (a . E a)^2 is a polynomial in cos 2a and cos 4a: five values determine it.
        angle(harmonics=2),
    ),
    about="fibres make the body stiffer along one direction",
    acts_on="material",
    wrinkles=False,
    energy=lambda point, c: c["k1"] / 2 * point.kin.invariant4_minus_1(point.kin.direction(c["angle"])) ** 2,
)
