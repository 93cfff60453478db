"""What a body shows of small steps of its gripper with any set of anchors, from one factorisation.

With K the tangent at rest while nothing but the gripper holds the body, and B the unknowns of a set's nodes, a step e of the
gripper moves the body without anchors as a whole, and with them by

    u = e - K^-1 B (B' K^-1 B)^-1 B' e:

every set is a dense system of the size of its anchors (Farhat & Roux, Int. J. Numer. Meth. Eng. 32 (1991) 1205). This is
exact for steps that are small; `bcid.forms.set_tangent` is the same about a state far from rest, for anchors held in the mean.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from bcid.base.errors import SolveError
from bcid.forms.forward import Forward
from bcid.forms.model import Model
from bcid.forms.solver.status import Status
from bcid.scene import Scene

Array = NDArray[np.float64]
# Dense systems of more unknowns cost more than following the sets.
_MOST = 2000


def undeformed(model: Model, scene: Scene) -> bool:
    """Whether a body is at rest without any deformation, whatever holds it, and nothing but its nodes is held."""
    return not (model.terms or model.rollers or scene.patch_directions)


class AnchorCompliance:
    """How far forces at the anchors' nodes move these nodes and the fiducials. Local to the process.

    Args:
        forward: the level, with a model that is `undeformed` at rest, without forces of the gripper; its mesh must not be shared.
        grasp: what the gripper holds.

    Raises:
        SolveError: the tangent cannot be factorised: the gripper alone does not hold the body.
    """

    def __init__(self, forward: Forward, grasp: str) -> None:
        equilibrium = forward.equilibrium
        equilibrium.hold((), grasp)
        dofs = forward.body.displacement_dofs.reshape(-1, 3)
        held = equilibrium.supports.prescribed
        scene, supports = forward.scene, equilibrium.supports
        held_by = {name: dofs[supports.nodes(name)][:, scene.held_along(name)].ravel() for name in scene.patches}
        every = np.unique(np.concatenate(list(held_by.values())))
        # What the gripper holds as well follows the gripper.
        free = every[~np.isin(every, held)]
        if equilibrium.verify() is not Status.CONVERGED:
            raise SolveError(f"grasp '{grasp}' alone does not hold the body")
        unit = np.zeros((len(equilibrium.u.x.array), len(free)))
        unit[free, np.arange(len(free))] = 1.0
        found = equilibrium.factor.solve_block(unit)
        steps = np.zeros((len(unit), 3))
        for axis in range(3):
            steps[dofs[:, axis], axis] = 1.0
        observe = forward.observer.of_unknowns()
        self.compliance, self.shown = found[free], np.asarray(observe @ found)
        self.steps, self.carried = steps[free], np.asarray(observe @ steps)
        self._columns = {name: np.flatnonzero(np.isin(free, own)) for name, own in held_by.items()}
        equilibrium.reset()

    def moved(self, anchors: Iterable[str]) -> Array:
        """Movement of the fiducials by a unit step of the gripper along each axis, with these anchors, shape (3, fiducials, 3)."""
        chosen = np.unique(np.concatenate([np.zeros(0, np.int64), *(self._columns[name] for name in anchors)]))
        moved = self.carried
        if len(chosen):
            factor = cho_factor(self.compliance[np.ix_(chosen, chosen)], check_finite=False)
            moved = moved - self.shown[:, chosen] @ cho_solve(factor, self.steps[chosen], check_finite=False)
        return np.asarray(moved.T.reshape(3, -1, 3))


def affordable(forward: Forward) -> bool:
    """Whether the anchors of all patches have few enough unknowns."""
    supports = forward.equilibrium.supports
    return 3 * sum(len(supports.nodes(name)) for name in forward.scene.patches) <= _MOST
