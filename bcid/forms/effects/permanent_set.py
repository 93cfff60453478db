"""Permanent set: strain that remains after loading, as in an elastic-plastic body that hardens.

In parallel with the law acts a spring in series with a slider (Prandtl's element; with the law beside it linear kinematic
hardening, Simo & Hughes, Computational Inelasticity, 1998, section 1.4). The spring's shear modulus is m = shear kept/(1 - kept),
so that `kept` is the part of the shear modulus at small strain that yields. The slider holds up to the strain y and follows
beyond: with d = dev E - p, and p the set after the last step, the energy of a step per rest volume is the least over the new set,

    m |d|^2  where |d| < y,    m (2 y |d| - y^2)  beyond,    after which p grows by (1 - y/|d|) d.

Every action begins without a set.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects import _needs, _slider
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount, Shape


def strain(point: Point) -> Any:
    """Strain of the spring if the slider did not move."""
    return ufl.dev(point.kin.E) - point.past.memory["set"]


def energy(point: Point, c: Constants) -> Any:
    """What a step stores in the spring and takes to move the slider."""
    modulus = point.shear * c["kept"] / (1 - c["kept"])
    return modulus * c["yield_strain"] ** 2 * _slider.work(strain(point), c["yield_strain"])


def advance(point: Point, c: Constants) -> dict[str, Any]:
    """The set after a step."""
    return {"set": point.past.memory["set"] + _slider.slid(strain(point), c["yield_strain"])}


effect = BodyEffect(
    name="permanent_set",
    parameters=(
        Amount(
            "kept",
            "1",
            "part of the shear modulus that yields",
            lower=0.0,
            upper=0.95,
            neutral=0.0,
            scale=0.3,
        ),
        Shape(
            "yield_strain",
            "1",
            "size of the strain beyond which the set follows",
            default=0.02,
            lower=0.0,
            open_lower=True,
            scale=0.01,
            scan=(0.02, 0.06),
        ),
    ),
    about="strain remains after loading",
    acts_on="material",
    wrinkles=False,
    energy=energy,
    memory={"set": (3, 3)},
    advance=advance,
    needs=_needs.motion,
)
