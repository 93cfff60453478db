"""LbfgsUpdate corrections of a factor that is kept for many iterations (limited-memory BFGS)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy.linalg.lapack import dtrtrs

from bcid.base.collective import Comm
from bcid.forms.solver.factor import Factor

Array = NDArray[np.float64]
_MOST = 12


class LbfgsUpdate:
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

    def __init__(self, factor: Factor, comm: Comm, curved: bool) -> None:
        self.factor, self.comm, self.curved = factor, comm, curved
        self.negative = False
        self._last: tuple[Array, Array] | None = None
        # The pairs are rows first .. last of two arrays, oldest first, with the table of their products s_i . y_j.
        self._rows: Array | None = None
        self._from = self._to = 0
        self._products: Array = np.zeros((0, 0))
        self._work: PETSc.Vec | None = None

    def clear(self) -> None:
        """Another factor, or another body: all pairs are stale."""
        self._last = None
        self._from = self._to = 0
        self._products = np.zeros((0, 0))
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
            self._add(step, change, along)

    def _add(self, step: Array, change: Array, along: float) -> None:
        """A pair more; the oldest goes when there are too many."""
        if self._rows is None:
            self._rows = np.empty((2, 2 * _MOST, len(step)))
        if self._to - self._from == _MOST:
            self._from += 1
            self._products = self._products[1:, 1:]
        if self._to == 2 * _MOST:
            kept = self._to - self._from
            self._rows[:, :kept] = self._rows[:, self._from : self._to]
            self._from, self._to = 0, kept
        steps = self._rows[0, self._from : self._to]
        count = len(steps)
        products = np.empty((count + 1, count + 1))
        products[:count, :count] = self._products
        # Only the upper triangle is ever used: older steps, newer changes.
        products[:count, count] = self._sum(steps @ change)
        products[count, count] = along
        self._rows[0, self._to], self._rows[1, self._to] = step, change
        self._to += 1
        self._products = products

    def correct(self, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solution = H right, where x - solution is the next iterate; collective."""
        residual = right.array_r.copy()
        self.observe(residual)
        if self._rows is None or self._from == self._to:
            self.factor.solve(right, solution)
        else:
            steps, changes = self._rows[:, self._from : self._to]
            weights, _ = dtrtrs(self._products, self._sum(steps @ residual))
            if self._work is None:
                self._work = right.duplicate()
            self._work.array[:] = residual - weights @ changes
            self.factor.solve(self._work, solution)
            back = np.diag(self._products) * weights - self._sum(changes @ solution.array_r)
            solution.array[:] += dtrtrs(self._products, back, trans=1)[0] @ steps
        self._last = -solution.array_r, residual

    def _sum(self, values: Array) -> Array:
        return np.asarray(self.comm.allreduce(values)) if self.comm.size > 1 else values

    def destroy(self) -> None:
        """Free the work vector; collective."""
        if self._work is not None:
            self._work.destroy()
