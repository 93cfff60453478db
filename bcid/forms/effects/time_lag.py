"""Time lag: the clocks of robot and camera differ.

What the camera sees at time t is the state at t - lag (s). Poses and loads are interpolated between the commanded ones,
straight for translations and loads, along the shortest arc for rotations; before the first step and after the last the
gripper stands still.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import Array, GripEffect
from bcid.forms.parameter import Amount
from bcid.measurement import Action
from bcid.scene.rotation import slerp


def retimed(clock: Array, values: Mapping[str, float]) -> Array:
    """The times by the robot's clock of what is seen at those of the camera's."""
    return np.asarray(np.clip(clock - values["seconds"], clock[0], clock[-1]))


def drive(action: Action, values: Mapping[str, float]) -> Action:
    """The motion as the camera's clock shows it."""
    clock = action.clock
    times = retimed(clock, values)
    later = np.clip(np.searchsorted(clock, times), 1, len(clock) - 1) if len(clock) > 1 else np.zeros(1, int)
    earlier = np.maximum(later - 1, 0)
    gap = clock[later] - clock[earlier]
    part = np.divide(times - clock[earlier], gap, out=np.zeros(len(times)), where=gap > 0)

    def straight(path: Array) -> Array:
        return path[earlier] + part[:, None] * (path[later] - path[earlier])

    turned = slerp(action.rotation[earlier], action.rotation[later], part)
    loads = {place: straight(load) for place, load in action.loads.items()}
    return replace(action, translation=straight(action.translation), rotation=turned, loads=loads)


effect = GripEffect(
    name="time_lag",
    parameters=(
        Amount(
            "seconds",
            "s",
            "by how much the camera is late",
            lower=-60.0,
            upper=60.0,
            neutral=0.0,
            scale=0.3,
        ),
    ),
    about="the clocks of robot and camera differ",
    acts_on="observation",
    drive=drive,
    retimed=retimed,
    needs=_needs.motion,
)
