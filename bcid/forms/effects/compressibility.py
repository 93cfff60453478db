"""Compressibility: another Poisson's ratio than the law was given.

It replaces the law's constant poisson; the other constants keep their values, so that with a law given by young the
shear modulus young / (2 (1 + poisson)) changes a little too. Without influence at the law's own value.
"""

from __future__ import annotations

from bcid.base.errors import InputError
from bcid.forms import materials
from bcid.forms.effects.effect import BodyEffect
from bcid.forms.materials.law import LARGEST_POISSON
from bcid.forms.parameter import Amount
from bcid.measurement import Measurement
from bcid.scene import Scene


def needs(scene: Scene, _measurement: Measurement) -> str:
    """A law with a Poisson's ratio."""
    try:
        law = materials.law(scene.material.law)
    except InputError as error:
        return str(error)
    if not any(parameter.name == "poisson" for parameter in law.parameters):
        return f"the law {law.name} has no constant poisson"
    own = float(scene.material.values["poisson"])
    return (
        "" if poisson.check(own) is None else f"the law's own poisson is {own:g}; the effect allows {poisson.allowed}"
    )


# The neutral value is the law's; 0.35 stands for it.
poisson = Amount(
    "poisson", "1", "Poisson's ratio", lower=0.0, upper=LARGEST_POISSON, neutral=0.35, law="poisson", scale=0.05
)

effect = BodyEffect(
    name="compressibility",
    parameters=(poisson,),
    about="another Poisson's ratio than the law was given",
    acts_on="material",
    constants=lambda c: {"poisson": c["poisson"]},
    needs=needs,
    instead_of="poisson",
)
