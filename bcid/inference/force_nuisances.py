"""What a force sensor has slightly wrong: its gain, what it shows without a force, and the weight of the gripper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.forms.gripper_force import torque_per_force
from bcid.inference.data import Data
from bcid.scene.rotation import as_rotation
from bcid.scene.uncertainty import Uncertainty

Array = NDArray[np.float64]


def force_modes(data: Data, sizes: Uncertainty, predicted: Array) -> list[tuple[str, Array]]:
    """Columns (n,), m, of one standard deviation each, with the name of the nuisance they belong to.

    The sensor turns with the gripper. What it shows without a force is the same in all actions, and drifts in each by itself.
    `predicted` are the values, (frames, rows, 3), m.
    """
    forces = data.forces
    if forces is None or not (data.kind > 0).any():
        return []
    found = [("force_gain", np.where(data.kind > 0, data.vector(predicted), 0.0) * float(sizes.force_gain or 0.0))]
    for axes in _axes(data):
        found.append(("force_bias", axes * float(sizes.force_bias or 0.0)))
        drift = axes * data.progress * float(sizes.force_drift or 0.0)
        found += [("force_drift", np.where(data.action == a, drift, 0.0)) for a in range(len(data.actions))]
    found += [("gripper_weight", column * float(sizes.gripper_weight or 0.0)) for column in _weights(data)]
    return found


def largest_force(data: Data) -> float:
    """N; 0 where none is measured."""
    return float(np.nanmax(np.abs(data.measurement.wrenches[:, :3]), initial=0.0)) if data.forces else 0.0


def _axes(data: Data) -> list[Array]:
    """A force of 1 N along each axis of the gripper in turn, and a torque that goes with it about each, (n,), m."""
    assert data.forces is not None
    turned = np.stack([_turned(data, unit) for unit in np.eye(3)])
    of_force, of_torque = 1 / data.forces.units.ravel()
    along = turned[:, data.frame, data.axis]
    found = [np.where(data.kind == 1, row * of_force, 0.0) for row in along]
    return found + [
        np.where(data.kind == 2, row * of_torque * torque_per_force(data.measurement.wrenches), 0.0) for row in along
    ]


def _weights(data: Data) -> list[Array]:
    """A weight of 1 N: its force, and torques about the grasp of arms along each axis of the gripper, (n,), m."""
    assert data.forces is not None
    down = np.array(data.scene.down, dtype=float)
    of_force, of_torque = 1 / data.forces.units.ravel()
    found = [np.where(data.kind == 1, down[data.axis] * of_force, 0.0)]
    for unit in np.eye(3):
        torque = np.cross(_turned(data, unit), down) * torque_per_force(data.measurement.wrenches)
        found.append(np.where(data.kind == 2, torque[data.frame, data.axis] * of_torque, 0.0))
    return found


def _turned(data: Data, direction: Array) -> Array:
    """A direction of the gripper in each frame, shape (frames, 3)."""
    return np.asarray(as_rotation(data.measurement.data["rotation"].values).apply(direction))
