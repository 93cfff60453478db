"""Permanent set: strain that remains after loading, as in an elastic-plastic body that hardens.

In parallel with the law acts a spring in series with a slider (Prandtl's element; with the law beside it linear kinematic
hardening, Simo & Hughes, Computational Inelasticity, 1998, section 1.4). The spring's shear modulus is m = shear kept/(1 - kept),
so that `kept` is the part of the shear modulus at small strain that yields. The slider holds up to the strain y and follows
beyond: with d = dev E - p, and p the set after the last step, the energy of a step per rest volume is the least over the new set,

    m |d|^2  where |d| < y,    m (2 y |d| - y^2)  beyond,    after which p grows by (1 - y/|d|) d.

From (1 - e) y to (1 + e) y, e = 0.05, the stress bends smoothly from one to the other. Every action begins without a set.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount, Shape

_EDGE = 0.05
_LOW, _HIGH = 1 - _EDGE, 1 + _EDGE
# Keeps the derivative of a norm finite where there is nothing.
_TINY = 1e-24


def strain(point: Point, c: Constants) -> tuple[Any, Any]:
    """Strain of the spring if the slider did not move, and its size in yield strains."""
    left = ufl.dev(point.kin.E) - point.past.memory["set"]
    return left, ufl.sqrt(ufl.inner(left, left) / c["yield_strain"] ** 2 + _TINY)


def _by_size(size: Any, below: Any, bend: Any, beyond: Any) -> Any:
    return ufl.conditional(ufl.lt(size, _LOW), below, ufl.conditional(ufl.lt(size, _HIGH), bend, beyond))


def energy(point: Point, c: Constants) -> Any:
    """What a step stores in the spring and takes to move the slider."""
    left, size = strain(point, c)
    below = ufl.inner(left, left) / c["yield_strain"] ** 2
    bend = _LOW**2 + 2 * (size - _LOW) + ((_HIGH - size) ** 3 - (2 * _EDGE) ** 3) / (6 * _EDGE)
    beyond = _LOW**2 + 4 * _EDGE - 4 * _EDGE**2 / 3 + 2 * (size - _HIGH)
    modulus = point.shear * c["kept"] / (1 - c["kept"])
    return modulus * c["yield_strain"] ** 2 * _by_size(size, below, bend, beyond)


def advance(point: Point, c: Constants) -> dict[str, Any]:
    """The set after a step: what the strain of the spring is more than the slider holds."""
    left, size = strain(point, c)
    part = _by_size(size, 1.0, (1 - (_HIGH - size) ** 2 / (4 * _EDGE)) / size, 1 / size)
    return {"set": point.past.memory["set"] + (1 - part) * left}


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
    energy=energy,
    memory={"set": (3, 3)},
    advance=advance,
    needs=_needs.motion,
)
