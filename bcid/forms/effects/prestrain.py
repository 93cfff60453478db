"""Prestrain: the scene's rest shape is already stretched.

The law sees F G with G = diag(sx, sy, sz) and its energy is per volume of the natural state, det G of which fill a unit
of the rest volume (multiplicative decomposition; Rausch & Kuhl, J. Mech. Phys. Solids 61, 2013). A free body would
shrink by 1/sx, 1/sy, 1/sz; a held one is under tension where a stretch is greater than 1.
"""

from __future__ import annotations

import ufl

from bcid.forms.effects.effect import BodyEffect
from bcid.forms.parameter import Amount

effect = BodyEffect(
    name="prestrain",
    parameters=tuple(
        Amount(f"s{axis}", "1", f"stretch along {axis}", lower=0.7, upper=1.4, neutral=1.0, scale=0.05)
        for axis in "xyz"
    ),
    about="the rest shape is already stretched",
    acts_on="material",
    growth=lambda _point, c: ufl.diag(ufl.as_vector([c["sx"], c["sy"], c["sz"]])),
)
