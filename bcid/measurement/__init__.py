"""The measurement: what was seen, the files it is read from, and whether it can be believed."""

from bcid.measurement.contents import AXES, FORMAT, QUATERNION, WRENCH, Units
from bcid.measurement.measurement import Measurement
from bcid.scene.action import Action

__all__ = [
    "AXES",
    "FORMAT",
    "QUATERNION",
    "WRENCH",
    "Action",
    "Measurement",
    "Units",
]
