"""Compressibility: another Poisson's ratio than the law was given.

It replaces the law's constant poisson; the other constants keep their values, so that with a law given by young the
shear modulus young / (2 (1 + poisson)) changes a little too. Without influence at the law's own value.
"""

from __future__ import annotations

from bcid.forms.effects._poisson import law_with_poisson, poisson
from bcid.forms.effects.effect import BodyEffect

effect = BodyEffect(
    name="compressibility",
    parameters=(poisson,),
    about="another Poisson's ratio than the law was given",
    acts_on="material",
    constants=lambda c: {"poisson": c["poisson"]},
    needs=law_with_poisson,
    instead_of="poisson",
)
