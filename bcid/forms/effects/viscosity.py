"""Viscosity: the body is stiffer while it is being deformed, and relaxes.

The law is the long-time behaviour. In parallel with it acts a Maxwell branch whose spring is an isochoric neo-Hookean
with the shear modulus m = shear fraction/(1 - fraction), so that `fraction` is the part of the instantaneous shear
modulus that relaxes. Its overstress m Q follows dQ/dt + Q/tau = dS/dt with S = J^(-2/3) (I - I1/3 C^-1), by the recursion
of Simo & Hughes (Computational Inelasticity, 1998, section 10.3), exact for a stress that changes linearly in time:

    Q_(k+1) = a Q_k + b (S_(k+1) - S_k),   a = exp(-dt/tau),   b = (1 - a) tau/dt

Within a step this is the gradient of an energy, m ((a Q_k - b S_k) : E + b/2 (I1bar - 3)) per rest volume.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.kinematics import Kinematics
from bcid.forms.parameter import Amount, Shape


def stress(kin: Kinematics) -> Any:
    """Second Piola-Kirchhoff stress of the branch's spring, per unit of its shear modulus."""
    return kin.J ** (-2 / 3) * (ufl.Identity(3) - kin.I1 / 3 * ufl.inv(kin.C))


def decay(point: Point, c: Constants) -> tuple[Any, Any]:
    """How much of the overstress, and of the change of stress, is left at the end of a step."""
    steps = point.past.dt / c["relaxation_time"]
    left = ufl.exp(-steps)
    return left, (1 - left) / steps


def energy(point: Point, c: Constants) -> Any:
    """Energy whose gradient is the overstress."""
    kept, added = decay(point, c)
    modulus = point.shear * c["fraction"] / (1 - c["fraction"])
    before = kept * point.past.memory["Q"] - added * stress(point.past.kin)
    return modulus * (ufl.inner(before, point.kin.E) + added / 2 * point.kin.I1bar_minus_3)


def advance(point: Point, c: Constants) -> dict[str, Any]:
    """Overstress after a step, per unit of the branch's shear modulus."""
    kept, added = decay(point, c)
    return {"Q": kept * point.past.memory["Q"] + added * (stress(point.kin) - stress(point.past.kin))}


effect = BodyEffect(
    name="viscosity",
    parameters=(
        Amount(
            "fraction",
            "1",
            "part of the instantaneous shear modulus that relaxes",
            lower=0.0,
            upper=0.95,
            neutral=0.0,
            scale=0.2,
            # All that is stiffer alike moves alike: little is seen of it before the body hardly changes its volume meanwhile.
            scan=(0.9,),
        ),
        Shape(
            "relaxation_time",
            "s",
            "time constant",
            default=3.0,
            lower=0.0,
            open_lower=True,
            scale=2.0,
            scan=(1.0, 3.0, 10.0, 30.0),
        ),
    ),
    about="the body is stiffer while it is being deformed, and relaxes",
    acts_on="material",
    wrinkles=False,
    energy=energy,
    memory={"Q": (3, 3)},
    advance=advance,
    needs=_needs.motion,
)
