"""Strain stiffening: the body gets stiffer the more it is stretched.

Energy per rest volume: c2 (I1bar - 3)^2, the second term of Yeoh's law (Rubber Chem. Technol. 66, 1993). It does nothing
at small strain: with I1bar - 3 about 3 e^2 in tension by e, and 15 kPa of Young's modulus, c2 = 5 kPa shows at e = 0.3.
"""

from __future__ import annotations

from bcid.forms.effects.effect import BodyEffect
from bcid.forms.parameter import Amount

effect = BodyEffect(
    name="strain_stiffening",
    parameters=(Amount("c2", "Pa", "coefficient of (I1bar - 3)^2", lower=0.0, upper=1e8, neutral=0.0, scale=5000.0),),
    about="the body gets stiffer the more it is stretched",
    acts_on="material",
    instead_of="law.part",
    energy=lambda point, c: c["c2"] * point.kin.I1bar_minus_3**2,
)
