"""Force and torque of the gripper as two further rows beside the fiducials, so that all that weighs positions weighs them too.

They are divided by a stiffness of the body (shear modulus times its extent) and the torque by that extent besides, which makes them
lengths of the size of displacements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Equilibrium
from bcid.forms.solver.supports import Pose
from bcid.measurement import Measurement
from bcid.scene import Scene

Array = NDArray[np.float64]
# Force and torque.
ROWS = 2


@dataclass(frozen=True)
class ForceScale:
    """What force and torque are divided by.

    Attributes:
        stiffness: N/m.
        lever: m.
    """

    stiffness: float
    lever: float

    @classmethod
    def of(cls, scene: Scene, measurement: Measurement) -> ForceScale | None:
        """Of a scene; None where the measurement holds no force."""
        return cls.of_body(scene) if np.isfinite(measurement.wrenches).any() else None

    @classmethod
    def of_body(cls, scene: Scene) -> ForceScale:
        """Of a scene, from its law and the extent of its markers and grasps."""
        model = Model.of(scene)
        points = np.vstack([scene.rest, *(np.array(grasp.centre)[None] for grasp in scene.grasps.values())])
        lever = max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-9)
        return cls(float(model.law.shear(model.law.complete(model.values))) * lever, lever)

    @property
    def units(self) -> Array:
        """N or N m per m of each row, shape (2, 1)."""
        return self.stiffness * np.array([[1.0], [self.lever]])

    def rows(self, wrenches: Array) -> Array:
        """Force and torque (..., 6), N and N m, as rows (..., 2, 3), m."""
        return np.asarray(wrenches.reshape(*wrenches.shape[:-1], ROWS, 3) / self.units)

    def wrenches(self, rows: Array) -> Array:
        """The inverse of `rows`."""
        return np.asarray((rows * self.units).reshape(*rows.shape[:-2], 3 * ROWS))


class GripperForce:
    """The rows of force and torque at a state of a body, and how they change with it; on one rank.

    Args:
        equilibrium: of the body.
        scale: what they are divided by.
    """

    def __init__(self, equilibrium: Equilibrium, scale: ForceScale) -> None:
        self.equilibrium, self.scale = equilibrium, scale

    def rows(self, pose: Pose) -> Array:
        """At the present state, shape (2, 3), m; collective."""
        return self.scale.rows(self.equilibrium.wrench(pose))

    def levers(self, pose: Pose) -> Array:
        """Each row and axis as a sum of nodal forces, shape (unknowns, 6): rigid motions of what the gripper holds, 1."""
        equilibrium, supports = self.equilibrium, self.equilibrium.supports
        found = np.zeros((len(equilibrium.u.x.array), 3 * ROWS))
        if not supports.grasp:
            return found
        body = equilibrium.body
        arms = supports.arms(pose)
        moves = np.zeros((len(arms), 3, 3 * ROWS))
        for axis, unit in enumerate(np.eye(3)):
            moves[:, axis, axis] = 1.0
            moves[:, :, 3 + axis] = np.cross(unit, arms)
        columns = np.zeros_like(found)
        columns[body.displacement_dofs] = (moves / np.repeat(self.scale.units.ravel(), 3)).reshape(-1, 3 * ROWS)
        found[supports.gripped] = columns[supports.gripped]
        return found

    def beside(self, observe: sp.csr_matrix, levers: Array) -> sp.csr_matrix:
        """What takes movements of the unknowns to those of fiducials, with the rows of force and torque below.

        By the tangent as it was assembled last, or that of the springs by which the gripper holds; `levers` are those of the
        present state.
        """
        equilibrium = self.equilibrium
        if equilibrium.supports.sprung:
            felt = -(equilibrium.springs.stiffness().T @ levers).T
        else:
            felt = equilibrium.tangent.times(levers, transpose=True).T
        return sp.vstack([observe, sp.csr_matrix(felt)], format="csr")

    def turned(self, forces: Array, more: Pose, less: Pose) -> Array:
        """Change of the rows where the gripper moves from one pose to another and its `forces` (unknowns,) stay, shape (6,), m."""
        equilibrium, supports = self.equilibrium, self.equilibrium.supports
        dofs = equilibrium.body.displacement_dofs
        held = np.where(np.isin(dofs, supports.gripped), forces[dofs], 0.0).reshape(-1, 3)
        away = (supports.moved(more) - supports.moved(less)).reshape(-1, 3) - (more.translation - less.translation)
        torque = np.cross(away, held).sum(axis=0)
        return self.scale.rows(np.concatenate([np.zeros(3), torque])).ravel()


def torque_per_force(wrenches: Array) -> float:
    """The largest torque per largest force, m, of forces (N) and torques (N m) of shape (..., 6)."""
    force, torque = (float(np.nanmax(np.abs(wrenches[..., part]), initial=0.0)) for part in (slice(3), slice(3, 6)))
    return torque / max(force, 1e-30)
