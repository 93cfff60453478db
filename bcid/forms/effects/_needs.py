"""Why an effect cannot act in a scene and measurement, in words: what several effects need."""

from __future__ import annotations

import numpy as np

from bcid.measurement import Measurement
from bcid.scene import Scene


def support(scene: Scene, _measurement: Measurement) -> str:
    """A surface on which the body lies."""
    if scene.support:
        return ""
    return 'the scene names no support surface: add support = "NAME" with a place of that name'


def regions(scene: Scene, _measurement: Measurement) -> str:
    """Parts of the body with a known outline."""
    return "" if scene.regions else "the scene names no part of the body in [regions]"


def single_markers(scene: Scene, _measurement: Measurement) -> str:
    """Fiducials that are points and no means of many."""
    if len(scene.surface) == len(scene.fiducials):
        return "there are no fiducials"
    return "the fiducials are means of points of a dense field" if scene.members else ""


def motion(_scene: Scene, measurement: Measurement) -> str:
    """Something that changes with time, a gripper or a load."""
    for action in measurement.actions:
        if any(np.ptp(path, axis=0).any() for path in (action.translation, action.rotation, *action.loads.values())):
            return ""
    return "neither gripper nor loads move in this measurement: nothing depends on time"


def moving_grasp(_scene: Scene, measurement: Measurement) -> str:
    """A gripper that moves what it holds."""
    for action in measurement.actions:
        if action.grasp and (np.ptp(action.translation, axis=0).any() or np.ptp(action.rotation, axis=0).any()):
            return ""
    return "no gripper moves in this measurement"
