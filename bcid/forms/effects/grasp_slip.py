"""Grasp slip: the tissue lags behind the gripper.

What is held moves by (1 - lag) times the commanded translation and turns by (1 - lag) times the commanded angle about
the same axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import Effect
from bcid.forms.parameter import Parameter
from bcid.forms.rotation import slerp
from bcid.measurement import Action


def drive(action: Action, values: Mapping[str, float]) -> Action:
    """How the held patch moves."""
    if not action.grasp:
        return action
    part, rest = 1 - values["lag"], np.array([1.0, 0.0, 0.0, 0.0])
    turned = np.array([slerp(rest, rotation, part) for rotation in action.rotation])
    return replace(action, translation=part * action.translation, rotation=turned)


effect = Effect(
    name="grasp_slip",
    parameters=(
        Parameter("lag", "1", "part of the motion that is lost", lower=0.0, upper=1.0, neutral=0.0, typical=0.1),
    ),
    about="the tissue lags behind the gripper",
    acts_on="grasp",
    drive=drive,
    needs=_needs.moving_grasp,
)
