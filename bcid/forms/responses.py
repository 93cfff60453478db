"""What changes of the residual move, to first order: C K^-1 dR with the tangent K of a converged state.

The products C K^-1 cost three triangular solves for each fiducial, and then serve whatever is asked about that state; with many
fiducials each change is solved for instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.forms.forward import Forward
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Equilibrium
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose

Array = NDArray[np.float64]
# Products of the latest states are kept, up to this size.
_KEPT_BYTES = 128e6
# They are made where their number is at most so many times that of the changes: they serve later questions about the same state.
_SERVED = 4
# Changes that are solved for at once.
_BLOCK = 256


@dataclass(frozen=True)
class Response:
    """Of one state, whose tangent was assembled last, and factorised where there are no products.

    Attributes:
        equilibrium: at that state.
        observe: what is measured of movements of the unknowns, shape (3 * rows, unknowns).
        levers: of forces where the gripper holds, shape (unknowns, 6 or 0); zero where it holds by springs, which feel movements
            alone.
        products: K^-1 C^T, zero where something is held, shape (unknowns, 3 * rows); None where changes are solved for.
    """

    equilibrium: Equilibrium
    observe: sp.csr_matrix
    levers: Array
    products: Array | None

    def moved(self, changes: Any) -> Array:
        """What changes of the residual (unknowns, n), dense or sparse, move, shape (3 * rows, n), m."""
        found = self._direct(changes)
        free = np.ones((changes.shape[0], 1), dtype=bool)
        free[self.equilibrium.supports.prescribed] = False
        if self.products is not None:
            held = changes.multiply(free).tocsc() if sp.issparse(changes) else changes * free
            return np.asarray(found - self.products.T @ held)
        for first in range(0, changes.shape[1], _BLOCK):
            part = changes[:, first : first + _BLOCK]
            part = (part.toarray() if sp.issparse(part) else part) * free
            found[:, first : first + _BLOCK] -= self.observe @ self.equilibrium.factor.solve_block(part)
        return found

    @property
    def adjoint(self) -> Array:
        """Movements on which a change of the residual does as much virtual work as it moves, shape (unknowns, 3 * rows)."""
        found = -(_products(self.equilibrium, self.observe) if self.products is None else self.products)
        found[:, found.shape[1] - self.levers.shape[1] :] += self.levers
        return found

    def solved(self, changes: Array) -> Array:
        """K^-1 dR of changes (unknowns, n), zero where something is held; the tangent must have been factorised for it."""
        held = changes.copy()
        held[self.equilibrium.supports.prescribed] = 0.0
        return self.equilibrium.factor.solve_block(held)

    def _direct(self, changes: Any) -> Array:
        """What the gripper feels of changes where it holds, shape (3 * rows, n), m."""
        found = np.zeros((self.observe.shape[0], changes.shape[1]))
        found[len(found) - self.levers.shape[1] :] = (changes.T @ self.levers).T
        return found


class Responses:
    """Responses of the states of one `Forward`, which must not share its mesh. Local to the process.

    Attributes:
        observe: from movements of the unknowns to those of fiducials, shape (3 * fiducials, unknowns).
    """

    def __init__(self, forward: Forward) -> None:
        self.forward, self.observe = forward, forward.observer.of_unknowns()
        self._kept: dict[bytes, Array] = {}

    def at(
        self, pose: Pose, model: Model, causes: int, fields: int, increments: bool, factorised: bool = False
    ) -> Response:
        """At the present state.

        Args:
            pose: of that state.
            model: the forward's, with effects on gripper and picture besides.
            causes: how many changes will be asked about by themselves.
            fields: how many as part of fields, which are asked about again.
            increments: whether the tangent is needed besides.
            factorised: whether it must be factorised, whatever is known of the state.

        Raises:
            SolveError: the tangent cannot be factorised.
        """
        equilibrium, forward = self.forward.equilibrium, self.forward
        key = self._key(pose, model)
        products = None if factorised else self._kept.get(key)
        if products is None:
            if equilibrium.verify() is Status.LINEAR_SOLVER:
                raise SolveError("the tangent of a converged step could not be factorised")
        elif forward.gripper_force or increments:
            equilibrium.tangent.assemble()
        observe, levers = self._observed(pose)
        if products is None and self._serve(observe.shape[0], causes, fields):
            products = _products(equilibrium, observe)
            self._keep(key, products)
        return Response(equilibrium, observe, levers, products)

    def make(self, pose: Pose, model: Model) -> None:
        """The products of the present state, for later questions about it, while its tangent serves the next step as well.

        Nothing is done where the tangent cannot be factorised.
        """
        equilibrium, key = self.forward.equilibrium, self._key(pose, model)
        if equilibrium.verify() is not Status.LINEAR_SOLVER and key not in self._kept:
            self._keep(key, _products(equilibrium, self._observed(pose)[0]))

    def worth(self, fields: int, states: int) -> bool:
        """Whether products of so many states will serve questions about so many changes, and can all be kept."""
        rows, unknowns = 3 * self.forward.rows, len(self.forward.equilibrium.u.x.array)
        return (
            not self.forward.equilibrium.model.remembers
            and self._serve(rows, 0, fields)
            and 8 * rows * unknowns * states <= _KEPT_BYTES
        )

    @staticmethod
    def _serve(rows: int, causes: int, fields: int) -> bool:
        return rows <= _SERVED * (causes + fields) if fields else rows < causes

    def _observed(self, pose: Pose) -> tuple[sp.csr_matrix, Array]:
        """What is measured of movements of the unknowns, and the levers of forces, see `Response`."""
        gripper = self.forward.gripper_force
        if gripper is None:
            return self.observe, np.zeros((self.observe.shape[1], 0))
        levers = gripper.levers(pose)
        sprung = self.forward.equilibrium.supports.sprung
        return gripper.beside(self.observe, levers), np.zeros_like(levers) if sprung else levers

    def _key(self, pose: Pose, model: Model) -> bytes:
        """What the tangent at the present state depends on; where it remembers, that is more than this, and nothing is kept."""
        equilibrium, constants = self.forward.equilibrium, self.forward.equilibrium.weak_form.constants
        numbers = equilibrium.weak_form.switches()
        numbers += [float(constants[name].value) for name in model.numbers() if name in constants]
        state = np.array([*numbers, pose.load_factor, pose.time])
        parts = (equilibrium.u.x.array, equilibrium.supports.prescribed, state)
        return blake2b(b"".join(part.tobytes() for part in parts)).digest()

    def _keep(self, key: bytes, products: Array) -> None:
        """For a later question about the same state."""
        if self.forward.equilibrium.model.remembers:
            return
        self._kept[key] = products
        while sum(kept.nbytes for kept in self._kept.values()) > _KEPT_BYTES and len(self._kept) > 1:
            self._kept.pop(next(iter(self._kept)))


def _products(equilibrium: Equilibrium, observe: sp.csr_matrix) -> Array:
    """K^-1 C^T with the factorised tangent."""
    right = observe.T.toarray()
    right[equilibrium.supports.prescribed] = 0.0
    return equilibrium.factor.solve_block(right, transpose=not equilibrium.model.symmetric)
