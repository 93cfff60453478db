"""Poisson's ratio as the amount of an effect: of the whole body, or of a region."""

from __future__ import annotations

from bcid.base.errors import InputError
from bcid.forms import materials
from bcid.forms.materials.law import LARGEST_POISSON
from bcid.forms.parameter import Amount
from bcid.measurement import Measurement
from bcid.scene import Scene


def law_with_poisson(scene: Scene, _measurement: Measurement) -> str:
    """A law with a Poisson's ratio that the effect allows."""
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
