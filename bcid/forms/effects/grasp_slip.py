"""Grasp slip: the tissue lags behind the gripper.

What is held moves by (1 - lag) times the commanded translation and turns by (1 - lag) times the commanded angle about
the same axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import GripEffect
from bcid.forms.parameter import Amount
from bcid.measurement import Action
from bcid.scene.rotation import slerp


def drive(action: Action, values: Mapping[str, float]) -> Action:
    """How the held patch moves."""
    if not action.grasp:
        return action
    part, rest = 1 - values["lag"], np.array([1.0, 0.0, 0.0, 0.0])
    rests = np.tile(rest, (len(action.rotation), 1))
    turned = slerp(rests, action.rotation, np.full(len(rests), part))
    return replace(action, translation=part * action.translation, rotation=turned)


effect = GripEffect(
    name="grasp_slip",
    parameters=(Amount("lag", "1", "part of the motion that is lost", lower=0.0, upper=1.0, neutral=0.0, scale=0.1),),
    about="the tissue lags behind the gripper",
    acts_on="grasp",
    drive=drive,
    needs=_needs.moving_grasp,
)
