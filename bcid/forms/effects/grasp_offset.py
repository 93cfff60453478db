"""Grasp offset: the gripper turns about another centre, and along other axes, than the scene says.

With the error d (m) of the centre c and the error R of the gripper's axes (a rotation vector, deg), a commanded
translation t and rotation q move a held point X by R t + (q' - 1)(X - c - d), where q' = R q R^-1. About the scene's
centre that is the rotation q' and the translation R t - (q' - 1) d. Which patch is held does not change. Without
rotation of the gripper d has no influence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import GripEffect
from bcid.forms.parameter import Amount
from bcid.measurement import Action
from bcid.scene.rotation import conjugated, from_vector, rotate


def drive(action: Action, values: Mapping[str, float]) -> Action:
    """How the held patch moves."""
    if not action.grasp:
        return action
    centre = np.array([[values[name] for name in ("x", "y", "z")]])
    axes = from_vector([values[name] for name in ("rx", "ry", "rz")])
    rotation = conjugated(axes, action.rotation)
    swung = np.concatenate([rotate(q, centre) - centre for q in rotation])
    return replace(action, translation=rotate(axes, action.translation) - swung, rotation=rotation)


effect = GripEffect(
    name="grasp_offset",
    parameters=(
        *(
            Amount(axis, "m", f"error of the centre along {axis}", lower=-0.1, upper=0.1, neutral=0.0, scale=0.005)
            for axis in "xyz"
        ),
        *(
            Amount(
                f"r{axis}", "deg", f"error of the axes about {axis}", lower=-60.0, upper=60.0, neutral=0.0, scale=5.0
            )
            for axis in "xyz"
        ),
    ),
    about="the gripper turns about another centre and moves along other axes",
    acts_on="grasp",
    drive=drive,
    needs=_needs.moving_grasp,
)
