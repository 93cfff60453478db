"""The measurement: what was seen, the files it is read from, and whether it can be believed.

Names are imported where they are asked for: a process that only reads a foreign file needs no xarray.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bcid.measurement.contents import AXES, FORMAT, QUATERNION, WRENCH, Units
    from bcid.measurement.measurement import Measurement
    from bcid.scene.action import Action

__all__ = ["AXES", "FORMAT", "QUATERNION", "WRENCH", "Action", "Measurement", "Units"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'bcid.measurement' has no attribute '{name}'")
    if name == "Action":
        return import_module("bcid.scene.action").Action
    return getattr(import_module(f"bcid.measurement.{'measurement' if name == 'Measurement' else 'contents'}"), name)
