"""Softening: once stretched, the body resists less until it is stretched further, as filled rubbers do (Mullins' effect).

The pseudo-elastic factor of Ogden & Roxburgh (Proc. R. Soc. A 455, 1999, equation 46), on a neo-Hookean part of the law. With
w = I1bar - 3, its largest value W up to the last step, and m = 3 strain^2, which is the w of a small stretch by `strain`, the
stress of that part is

    S = (1 - softened erf x) shear/2 dw/dE,    x = (W - w)/m  where w < W,    0  beyond,

of which all but the first term is the gradient of softened shear/2 m (x erf x + (exp(-x^2) - 1)/sqrt(pi)) per rest volume. A body
that is only stretched further and further shows none of it. Every action begins as if the body had never been stretched.
"""

from __future__ import annotations

import math
from typing import Any

import ufl

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount, Shape


def energy(point: Point, c: Constants) -> Any:
    """What is stored less, up to a constant, than by a body that was never stretched."""
    width = 3 * c["strain"] ** 2
    back = ufl.max_value(point.past.memory["largest"] - point.kin.I1bar_minus_3, 0.0) / width
    lost = back * ufl.erf(back) + (ufl.exp(-(back**2)) - 1) / math.sqrt(math.pi)
    return c["softened"] * point.shear / 2 * width * lost


def advance(point: Point, _c: Constants) -> dict[str, Any]:
    """The largest I1bar - 3 after a step."""
    return {"largest": ufl.max_value(point.past.memory["largest"], point.kin.I1bar_minus_3)}


effect = BodyEffect(
    name="softening",
    parameters=(
        Amount(
            "softened",
            "1",
            "part of the stress that is lost at most, on the way back",
            lower=0.0,
            upper=0.9,
            neutral=0.0,
            scale=0.3,
        ),
        Shape(
            "strain",
            "1",
            "strain that the body must go back for most of it",
            default=0.1,
            lower=0.0,
            open_lower=True,
            scale=0.05,
            scan=(0.05, 0.2),
        ),
    ),
    about="once stretched, the body resists less until it is stretched further",
    acts_on="material",
    energy=energy,
    memory={"largest": ()},
    advance=advance,
    needs=_needs.motion,
)
