"""Swelling: the body grows with time, the same in all directions.

The law sees F/g with the stretch g = exp(rate t) at the time t (s) of the measurement's clock, and its energy is per volume of
the natural state, g^3 of which fill a unit of the rest volume: isotropic growth at a constant rate (Rodriguez, Hoger & McCulloch,
J. Biomech. 27, 1994). A negative rate shrinks it, as drying does. At t = 0 the body is as the scene has it.
"""

from __future__ import annotations

import numpy as np
import ufl

from bcid.forms.effects.effect import BodyEffect
from bcid.forms.parameter import Amount
from bcid.measurement import Measurement
from bcid.scene import Scene


def needs(_scene: Scene, measurement: Measurement) -> str:
    """A clock that runs."""
    if any(np.ptp(action.clock) > 0 for action in measurement.actions):
        return ""
    return "no time passes in this measurement"


effect = BodyEffect(
    name="swelling",
    parameters=(
        # What acts in a frame is rate times time, the logarithm of the stretch.
        Amount("rate", "1/s", "growth of lengths per time", lower=-0.1, upper=0.1, neutral=0.0, scale=5e-4),
    ),
    about="the body grows or shrinks with time",
    acts_on="material",
    growth=lambda _point, c: ufl.exp(-c["rate"]) * ufl.Identity(3),
    acting=lambda time, values: {**values, "rate": values["rate"] * time},
    needs=needs,
)
