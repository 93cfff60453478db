"""What a measurement tells of a sheet: what lies in its plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bcid.base.errors import Problems
from bcid.measurement.contents import WRENCH
from bcid.measurement.measurement import Measurement
from bcid.scene import Scene
from bcid.scene.rotation import as_rotation

# A gripper may leave the plane by this part of the extent of markers and grasps, and tilt by this angle (rad). Lengths in the plane
# then err by half the square of it: 0.1 %.
_OUT = 0.05
_ACROSS = ("fz", "tx", "ty")


def in_plane(scene: Scene, measurement: Measurement) -> Measurement:
    """Of a sheet, the measurement without coordinates and forces across its plane; of other bodies as it is.

    Raises:
        InputError: the gripper leaves the plane of a sheet.
    """
    if not scene.thickness:
        return measurement
    _refuse_lifted(scene, measurement)
    data = measurement.data.copy(deep=True)
    data["position"][{"axis": 2}] = np.nan
    if "wrench" in data:
        data["wrench"][{"component": [WRENCH.index(name) for name in _ACROSS]}] = np.nan
    return replace(measurement, data=data)


def _refuse_lifted(scene: Scene, measurement: Measurement) -> None:
    problems = Problems(f"measurement {measurement.source} does not fit scene {scene.source}")
    points = np.vstack([scene.rest, *(np.array(grasp.centre)[None] for grasp in scene.grasps.values())])
    size = float(np.linalg.norm(np.ptp(points[:, :2], axis=0)))
    for action in measurement.actions:
        if not action.grasp:
            continue
        lift = float(np.abs(action.translation[:, 2]).max())
        upright = as_rotation(action.rotation).apply([0.0, 0.0, 1.0])[:, 2].min()
        tilt = float(np.arccos(np.clip(upright, -1.0, 1.0)))
        if lift > _OUT * size or tilt > _OUT:
            problems.add(
                measurement.source,
                f"action {action.name}: the gripper leaves the plane of the sheet, by up to {lift * 1e3:.3g} mm and "
                f"{np.degrees(tilt):.3g} deg; a sheet (geometry.thickness) stays within {_OUT * size * 1e3:.3g} mm "
                f"and {np.degrees(_OUT):.2g} deg of its plane: name a geometry of tetrahedra, or leave this action out",
            )
    problems.raise_if_any()
