"""Another form U(J) of the law's volumetric energy: an effect for each form.

To the law's energy a part of bulk (u - own) is added, with the unit energy u(J) of the form, and own(J) of the law, see
`bcid.forms.materials.law.Law`. With part = 1 the law has the other form. All forms agree to second order in J - 1: they
differ where the volume changes much.

Source: S. Doll & K. Schweizerhof, On the development of volumetric strain energy functions, J. Appl. Mech. 67 (2000) 17.
"""

from __future__ import annotations

from bcid.base.errors import InputError
from bcid.forms import materials
from bcid.forms.effects.effect import BodyEffect
from bcid.forms.materials.law import Volumetric
from bcid.forms.parameter import Amount
from bcid.measurement import Measurement
from bcid.scene import Scene


def form_effect(form: Volumetric, formula: str) -> BodyEffect:
    """The effect of a form of U(J), whose unit energy is a formula in words."""

    def needs(scene: Scene, _measurement: Measurement) -> str:
        material = scene.material
        if material.formulation == "mixed":
            return (
                "the mixed formulation is for bodies that hardly change their volume: all forms of U(J) are alike there"
            )
        try:
            others = materials.law(material.law).other_forms(material.volumetric)
        except InputError as error:
            return str(error)
        if not others:
            return f"the law {material.law} has no separate volumetric energy"
        return "" if form in others else f"the law's volumetric energy has the form {form} already"

    return BodyEffect(
        name=f"volumetric_{form}",
        parameters=(
            Amount("part", "1", "part of this form, 1 for all of it", lower=0.0, upper=1.0, neutral=0.0, scale=1.0),
        ),
        about=f"the energy of a change of volume is {formula} times the bulk modulus",
        acts_on="material",
        volumetric=lambda _point, c: {form: c["part"]},
        needs=needs,
    )
