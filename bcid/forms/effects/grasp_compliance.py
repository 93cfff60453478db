"""Grasp compliance: the gripper gives, so that what it holds lags behind in proportion to what pulls back on it.

Potential: k/2 |u - g|^2 per rest area of the held patch, with the stiffness k (Pa/m) and the displacement g that the patch would
have if it moved with the gripper: a soft layer between jaw and tissue, of Young's modulus E and thickness h, has about E/h.
The patch is no longer prescribed, and turns against the gripper as well, the more easily the smaller it is. The gripper's
force and torque are those of the springs. An infinite stiffness is the rigid gripper.
"""

from __future__ import annotations

import math
from typing import Any

import ufl

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount


def potential(point: Point, c: Constants) -> Any:
    """Energy of the springs."""
    lag = point.u - point.gripper
    stored = c["stiffness"] / 2 * ufl.inner(lag, lag)
    return sum(point.grasped(grasp) * stored * point.grip(grasp) for grasp in point.grasps)


effect = BodyEffect(
    name="grasp_compliance",
    parameters=(
        Amount(
            "stiffness",
            "Pa/m",
            "force per area and displacement",
            lower=0.0,
            open_lower=True,
            neutral=math.inf,
            scale=5e5,
        ),
    ),
    about="the gripper gives to what pulls back on it",
    acts_on="grasp",
    potential=potential,
    gives=True,
    needs=_needs.moving_grasp,
)
