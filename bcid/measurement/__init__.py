"""The measurement: what was seen, the files it is read from, and whether it can be believed."""

from bcid.measurement.measurement import (
    AXES,
    FORMAT,
    QUATERNION,
    WRENCH,
    Measurement,
    Units,
    quaternion_rotate,
)
from bcid.scene.action import Action

__all__ = [
    "AXES",
    "FORMAT",
    "QUATERNION",
    "WRENCH",
    "Action",
    "Measurement",
    "Units",
    "quaternion_rotate",
]
