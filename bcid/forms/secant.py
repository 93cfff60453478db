"""Secant corrections of a factor that is kept for many iterations (limited-memory BFGS)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy.linalg import solve_triangular

from bcid.forms.factor import Factor

Array = NDArray[np.float64]
_MOST = 12


class Secant:
    """Newton corrections from a factor that has grown old, and from what the residual did since.

    With H the old factor's inverse, the corrections s and the changes y of the residual that they caused, the
    correction is that of the BFGS update of H by the last pairs (s, y) (Nocedal & Wright 2006, algorithm 7.4, with the
    recursion written as two triangular solves). The pairs outlive a time step: neighbouring equilibria have nearly the
    same tangent. Only for symmetric, positive definite tangents (`curved`); for others the old factor is used as it is.

    Args:
        factor: the factor.
        comm: ranks that share the unknowns.
        curved: whether pairs are used.

    Attributes:
        negative: a pair with negative curvature has been seen: the tangent is no longer positive definite.
    """

    def __init__(self, factor: Factor, comm: Any, curved: bool) -> None:
        self.factor, self.comm, self.curved = factor, comm, curved
        self.negative = False
        self._steps: list[Array] = []
        self._changes: list[Array] = []
        self._last: tuple[Array, Array] | None = None
        self._tables: tuple[Array, Array, Array] | None = None
        self._work: PETSc.Vec | None = None

    def clear(self) -> None:
        """Another factor, or another body: all pairs are stale."""
        self._steps, self._changes, self._last, self._tables = [], [], None, None
        self.negative = False

    def pause(self) -> None:
        """The iteration ends here: the next residual is not the answer to the last correction."""
        self._last = None

    def observe(self, residual: Array) -> None:
        """Take the residual (this rank's part) that the last correction has led to; collective."""
        if self._last is None or not self.curved:
            return
        step, before = self._last
        self._last = None
        change = residual - before
        along, squares, changed = self._sum(np.array([step @ change, step @ step, change @ change]))
        self.negative |= bool(along <= 0.0)
        if along > 1e-8 * np.sqrt(squares * changed):
            self._steps = [*self._steps, step][-_MOST:]
            self._changes = [*self._changes, change][-_MOST:]
            self._tables = None

    def correct(self, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solution = H right, where x - solution is the next iterate; collective."""
        residual = right.array_r.copy()
        self.observe(residual)
        if not self._steps:
            self.factor.solve(right, solution)
        else:
            steps, changes, upper = self._table()
            weights = solve_triangular(upper, self._sum(steps @ residual))
            if self._work is None:
                self._work = right.duplicate()
            self._work.array[:] = residual - weights @ changes
            self.factor.solve(self._work, solution)
            back = np.diag(upper) * weights - self._sum(changes @ solution.array_r)
            solution.array[:] += solve_triangular(upper, back, trans="T") @ steps
        self._last = -solution.array_r, residual

    def _table(self) -> tuple[Array, Array, Array]:
        """Steps and changes as rows, and the upper triangle of their products s_i . y_j."""
        if self._tables is None:
            steps, changes = np.array(self._steps), np.array(self._changes)
            self._tables = steps, changes, np.triu(self._sum(steps @ changes.T))
        return self._tables

    def _sum(self, values: Array) -> Array:
        return np.asarray(self.comm.allreduce(values)) if self.comm.size > 1 else values

    def destroy(self) -> None:
        """Free the work vector; collective."""
        if self._work is not None:
            self._work.destroy()
