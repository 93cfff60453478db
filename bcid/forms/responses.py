"""What changes of the residual and of what is prescribed move, to first order, with the tangent K of a converged state.

A change dR of the residual moves the fiducials by -C K^-1 dR, with C what observes them; a change du_a of what is prescribed by
C_a du_a - C K^-1 K_fa du_a. The products C K^-1 and C_a - C K^-1 K_fa cost three triangular solves for each fiducial, and then
serve whatever is asked about that state, without its tangent; with many fiducials each change is solved for instead.
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
class Products:
    """Of one state.

    Attributes:
        by_forces: K^-1 C^T, zero where something is held, shape (unknowns, 3 * rows).
        held: the unknowns that are prescribed, shape (held,).
        by_moves: what a unit of each of them moves, shape (held, 3 * rows).
    """

    by_forces: Array
    held: NDArray[np.int32]
    by_moves: Array

    @property
    def nbytes(self) -> int:
        """In memory."""
        return self.by_forces.nbytes + self.by_moves.nbytes


@dataclass(frozen=True)
class Response:
    """Of one state; where there are no products its tangent was factorised last.

    Attributes:
        equilibrium: at that state.
        places: from movements of the unknowns to those of fiducials, shape (3 * fiducials, unknowns).
        rows: how much is measured: three numbers of each fiducial, and those of force and torque.
        levers: of forces where the gripper holds, shape (unknowns, 6 or 0); zero where it holds by springs, which feel movements
            alone.
        observe: what is measured of movements of the unknowns, shape (rows, unknowns); None where there are products.
        products: None where changes are solved for.
    """

    equilibrium: Equilibrium
    places: sp.csr_matrix
    rows: int
    levers: Array
    observe: sp.csr_matrix | None
    products: Products | None

    def moved(self, changes: Any, increments: Array | None = None) -> Array:
        """What changes of the residual, dense or sparse, and of what is prescribed move, each (unknowns, n), shape (rows, n), m."""
        if self.products is None:
            return self._solved(changes, increments)
        free = np.ones((changes.shape[0], 1), dtype=bool)
        free[self.equilibrium.supports.prescribed] = False
        held = changes.multiply(free).tocsc() if sp.issparse(changes) else changes * free
        found = self._direct(changes) - self.products.by_forces.T @ held
        if increments is not None:
            found += self.products.by_moves.T @ increments[self.products.held]
        return np.asarray(found)

    def _solved(self, changes: Any, increments: Array | None) -> Array:
        """The same with the factorised tangent."""
        assert self.observe is not None
        if increments is not None:
            changes = changes + self.equilibrium.tangent.times(increments)
        found = self._direct(changes)
        if increments is not None:
            found[: self.places.shape[0]] += self.places @ increments
        free = np.ones((changes.shape[0], 1), dtype=bool)
        free[self.equilibrium.supports.prescribed] = False
        for first in range(0, changes.shape[1], _BLOCK):
            part = changes[:, first : first + _BLOCK]
            part = (part.toarray() if sp.issparse(part) else part) * free
            found[:, first : first + _BLOCK] -= self.observe @ self.equilibrium.factor.solve_block(part)
        return found

    @property
    def adjoint(self) -> Array:
        """Movements on which a change of the residual does as much virtual work as it moves, shape (unknowns, 3 * rows)."""
        if self.products is None:
            assert self.observe is not None
            found = -_by_forces(self.equilibrium, self.observe)
        else:
            found = -self.products.by_forces
        found[:, found.shape[1] - self.levers.shape[1] :] += self.levers
        return found

    def solved(self, changes: Array) -> Array:
        """K^-1 dR of changes (unknowns, n), zero where something is held; the tangent must have been factorised for it."""
        held = changes.copy()
        held[self.equilibrium.supports.prescribed] = 0.0
        return self.equilibrium.factor.solve_block(held)

    def _direct(self, changes: Any) -> Array:
        """What the gripper feels of changes where it holds, shape (3 * rows, n), m."""
        found = np.zeros((self.rows, changes.shape[1]))
        found[len(found) - self.levers.shape[1] :] = (changes.T @ self.levers).T
        return found


class Responses:
    """Responses of the states of one `Forward`, which must not share its mesh. Local to the process.

    Attributes:
        observe: from movements of the unknowns to those of fiducials, shape (3 * fiducials, unknowns).
    """

    def __init__(self, forward: Forward) -> None:
        self.forward, self.observe = forward, forward.observer.of_unknowns()
        self._kept: dict[bytes, Products] = {}

    def at(self, pose: Pose, model: Model, causes: int, fields: int, factorised: bool = False) -> Response:
        """At the present state.

        Args:
            pose: of that state.
            model: the forward's, with effects on gripper and picture besides.
            causes: how many changes will be asked about by themselves.
            fields: how many as part of fields, which are asked about again.
            factorised: whether the tangent must be factorised, whatever is known of the state.

        Raises:
            SolveError: the tangent cannot be factorised.
        """
        equilibrium, key = self.forward.equilibrium, self._key(pose, model)
        products, observe, levers = None if factorised else self._kept.get(key), None, self._levers(pose)
        if products is None:
            if equilibrium.verify() is Status.LINEAR_SOLVER:
                raise SolveError("the tangent of a converged step could not be factorised")
            observe = self._observed(pose)
            if self._serve(observe.shape[0], causes, fields):
                products = self._made(key, observe, levers)
        return Response(equilibrium, self.observe, 3 * self.forward.rows, levers, observe, products)

    def make(self, pose: Pose, model: Model) -> None:
        """The products of the present state, for later questions about it, while its tangent serves the next step as well.

        Nothing is done where the tangent cannot be factorised.
        """
        equilibrium, key = self.forward.equilibrium, self._key(pose, model)
        if equilibrium.verify() is not Status.LINEAR_SOLVER and key not in self._kept:
            self._made(key, self._observed(pose), self._levers(pose))

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

    def _levers(self, pose: Pose) -> Array:
        """Of forces, see `Response`."""
        gripper, equilibrium = self.forward.gripper_force, self.forward.equilibrium
        if gripper is None or equilibrium.supports.sprung:
            return np.zeros((self.observe.shape[1], self.forward.rows * 3 - self.observe.shape[0]))
        return gripper.levers(pose)

    def _observed(self, pose: Pose) -> sp.csr_matrix:
        """What is measured of movements of the unknowns, with the tangent as it was assembled last."""
        gripper = self.forward.gripper_force
        return self.observe if gripper is None else gripper.beside(self.observe, gripper.levers(pose))

    def _made(self, key: bytes, observe: sp.csr_matrix, levers: Array) -> Products:
        """The products with the factorised tangent, for later questions about the same state as well."""
        equilibrium = self.forward.equilibrium
        by_forces, held = _by_forces(equilibrium, observe), equilibrium.supports.prescribed
        pulled = -by_forces
        pulled[:, pulled.shape[1] - levers.shape[1] :] += levers
        by_moves = equilibrium.tangent.times_in(held, pulled, transpose=True)
        by_moves[:, : self.observe.shape[0]] += self.observe[:, held].T.toarray()
        products = Products(by_forces, held, by_moves)
        self._keep(key, products)
        return products

    def _key(self, pose: Pose, model: Model) -> bytes:
        """What the tangent at the present state depends on; where it remembers, that is more than this, and nothing is kept."""
        equilibrium, constants = self.forward.equilibrium, self.forward.equilibrium.weak_form.constants
        numbers = equilibrium.weak_form.switches()
        numbers += [float(constants[name].value) for name in model.numbers() if name in constants]
        state = np.array([*numbers, pose.load_factor, pose.time])
        parts = (equilibrium.u.x.array, equilibrium.supports.prescribed, state)
        return blake2b(b"".join(part.tobytes() for part in parts)).digest()

    def _keep(self, key: bytes, products: Products) -> None:
        """For a later question about the same state."""
        if self.forward.equilibrium.model.remembers:
            return
        self._kept[key] = products
        while sum(kept.nbytes for kept in self._kept.values()) > _KEPT_BYTES and len(self._kept) > 1:
            self._kept.pop(next(iter(self._kept)))


def _by_forces(equilibrium: Equilibrium, observe: sp.csr_matrix) -> Array:
    """K^-1 C^T with the factorised tangent."""
    right = observe.T.toarray()
    right[equilibrium.supports.prescribed] = 0.0
    return equilibrium.factor.solve_block(right, transpose=not equilibrium.model.symmetric)
