"""The measurement: what was seen, the files it is read from, and whether it can be believed.

Names are imported where they are asked for: a process that only reads a foreign file needs no xarray.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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


def __getattr__(name: str) -> Any:
    if name == "Measurement":
        from bcid.measurement.measurement import Measurement

        return Measurement
    if name == "Action":
        from bcid.scene.action import Action

        return Action
    if name in __all__:
        from bcid.measurement import contents

        return getattr(contents, name)
    raise AttributeError(f"module 'bcid.measurement' has no attribute '{name}'")
