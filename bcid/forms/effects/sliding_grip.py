"""Sliding grip: the gripper leads its patch along the normal, and holds it across that by springs or not at all.

Potential: (k_n/2 (N . d)^2 + k/2 |d|^2) per rest area of the held patch, where d = u - g is what the patch lags behind, g the
displacement that it would have if it moved with the gripper, and N the outward normal of the body at rest. The stiffness k_n along
the normal stands for a rigid contact. With a stiffness k (Pa/m) of zero the patch slides freely, as between rollers; an infinite
one is the rigid gripper. The gripper's force and torque are those of the springs.
"""

from __future__ import annotations

import math
from typing import Any

import ufl

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.effects.roller import RIGID
from bcid.forms.parameter import Amount, Shape


def potential(point: Point, c: Constants) -> Any:
    """Energy of the springs."""
    lag = point.u - point.gripper
    stored = c["normal"] * ufl.inner(point.N, lag) ** 2 + c["across"] * ufl.inner(lag, lag)
    return sum(point.grasped(grasp) * stored / 2 * point.grip(grasp) for grasp in point.grasps)


effect = BodyEffect(
    name="sliding_grip",
    parameters=(
        Amount(
            "across",
            "Pa/m",
            "force per area and displacement across the normal",
            lower=0.0,
            neutral=math.inf,
            scale=5e5,
        ),
        Shape(
            "normal",
            "Pa/m",
            "force per area and displacement along the normal",
            default=RIGID,
            lower=0.0,
            open_lower=True,
        ),
    ),
    about="the gripper leads along the normal, and the body slides across it",
    acts_on="grasp",
    potential=potential,
    gives=True,
    needs=_needs.moving_grasp,
    only_named=True,
)
