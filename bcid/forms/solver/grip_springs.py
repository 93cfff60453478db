"""Springs between the gripper and what it holds, where an effect has put them in the place of a rigid grip."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fp
from numpy.typing import NDArray
from petsc4py import PETSc

from bcid.base import compat
from bcid.forms import compiled

Array = NDArray[np.float64]
# Of a sum of large forces that cancel each other this part is round-off.
_ROUND_OFF = 1e-15


class GripSprings:
    """What the springs do to the nodes that they hold. Collective on the body's communicator.

    Args:
        residuals: forms of the effects that are these springs; there may be none.
        u: the unknown.
        vector: a PETSc vector of the unknowns, to be copied.

    Attributes:
        forces: of the gripper on this rank's own unknowns, at the last `update`, N.
        round_off: norm of what cannot be told of them at the last `stretch`, N.
    """

    def __init__(self, residuals: Sequence[Any], u: Any, vector: PETSc.Vec) -> None:
        self._residuals, self._u = residuals, u
        self._forms = [compiled.form(residual) for residual in residuals]
        self._vector = vector.duplicate()
        self.forces = np.zeros(vector.getLocalSize())
        self.round_off = 0.0

    def update(self) -> None:
        """The forces at the present state."""
        if not self._forms:
            return
        with self._vector.localForm() as local:
            local.set(0.0)
        for form in self._forms:
            fp.assemble_vector(self._vector, form)
        self._vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        self.forces[:] = -self._vector.array_r

    def stretch(self) -> None:
        """The gripper has moved: how large the forces are of which only a difference acts."""
        if self._forms:
            state = self._u.x.array.copy()
            self._u.x.array[:] = 0.0
            self.update()
            self.round_off = _ROUND_OFF * self._vector.norm()
            self._u.x.array[:] = state

    @cached_property
    def _tangents(self) -> list[Any]:
        with compat.compiling():
            return [compiled.form(ufl.derivative(residual, self._u)) for residual in self._residuals]

    def stiffness(self) -> sp.csr_matrix:
        """Force by which they resist a unit movement of each unknown, at the present state, N/m; one rank only."""
        return sum(fem.assemble_matrix(form).to_scipy() for form in self._tangents)

    def destroy(self) -> None:
        """Free the PETSc vector."""
        self._vector.destroy()
