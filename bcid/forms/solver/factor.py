"""The factorised tangent: a PETSc preconditioner that knows whether the matrix was positive definite."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from bcid.forms.solver.multigrid import Multigrid

Array = NDArray[np.float64]
# PETSc's numbers of errors: no memory; no such factorisation in this PETSc.
OUT_OF_MEMORY, MISSING = 55, 92
# Packages that this PETSc was found not to have.
_absent: set[str] = set()
# CHOLMOD must not print, and must factorise by supernodes: its simplicial LDL^T, which it prefers for small matrices,
# does not stop at a negative pivot. MUMPS: PORD ordering suits these meshes, the root stays sequential and null pivots
# are looked for, so that the signs are counted right; on several ranks the work space that it estimates may not do.
_OPTIONS: dict[str, dict[str, int | float | str]] = {
    "cholmod": {"mat_cholmod_print": 0, "mat_cholmod_factor": "SUPERNODAL"},
    "mumps": {"mat_mumps_icntl_7": 4, "mat_mumps_icntl_13": 1, "mat_mumps_icntl_14": 200, "mat_mumps_icntl_24": 1},
}


class Factor:
    """Direct factorisation of the tangent, with the sign of its pivots; SNES uses it through a `FactorShell`.

    CHOLMOD, the fastest here on one rank, stops at a pivot that is not positive; then, on shared meshes, for the
    saddle points of the mixed formulation, and where PETSc has no CHOLMOD, MUMPS takes over (LDL^T), which counts the
    negative pivots. A tangent that
    is not symmetric gets MUMPS' LU, which knows no signs. With the places of its nodes (`nodes`) it is not factorised at all:
    conjugate gradients with algebraic multigrid (GAMG) solve with it, and negative curvature is only seen where they
    pass.

    Args:
        matrix: the assembled tangent.
        symmetric: whether it is symmetric.
        saddle: number of pressures: this many negative pivots are right.
        nodes: of a large mesh that is to be solved iteratively, see `Multigrid`.

    Attributes:
        count: factorisations so far.
        usable: whether the last one succeeded and nobody has declared it stale since.
        negative: how many pivots are negative beyond `saddle`; None when it is not known.
        starved: whether the last one failed because memory was short.
    """

    def __init__(self, matrix: PETSc.Mat, symmetric: bool = True, saddle: int = 0, nodes: Array | None = None) -> None:
        self.matrix = matrix
        self.symmetric = symmetric
        self.saddle = saddle
        self.count = 0
        self.usable = False
        self.negative: int | None = None
        self.starved = False
        self._definite = symmetric and not saddle and matrix.comm.size == 1
        self._indefinite = False
        self._made: dict[str, PETSc.PC] = {}
        self._current: PETSc.PC | None = None
        self._half = PETSc.Mat()
        self.multigrid = None if nodes is None else Multigrid(matrix, nodes)

    def reset(self) -> None:
        """Another state: the last factor is stale, and CHOLMOD is tried again if it has failed."""
        self.usable = False
        self._indefinite = False

    def constrain(self) -> None:
        """Other unknowns are held from now on; collective."""
        self.reset()
        if self.multigrid is not None:
            self.multigrid.forget()

    def refresh(self) -> bool:
        """Factorise the matrix as it now is; False when that fails. Collective."""
        self.count += 1
        self.negative = None
        self.starved = False
        if self.multigrid is not None:
            self.multigrid.update()
            self.negative, self.usable = 0, True
            return True
        definite = self._definite and not self._indefinite and "cholmod" not in _absent
        self.usable = (definite and self._factorise("cholmod")) or self._factorise("mumps")
        return self.usable

    def _factorise(self, package: str) -> bool:
        if package not in self._made:
            self._made[package] = self._create(package)
        inner = self._made[package]
        try:
            inner.setOperators(self._upper() if package == "cholmod" else self.matrix)
            inner.setUp()
            reason = inner.getFailedReason()
            failed = reason != PETSc.PC.FailedReason.NOERROR
            self.starved |= reason == PETSc.PC.FailedReason.FACTOR_OUTMEMORY
        except PETSc.Error as error:
            failed = True
            self.starved |= error.ierr == OUT_OF_MEMORY
            if error.ierr == MISSING:
                _forget(package)
        if failed:
            # PETSc takes a factorisation that has failed for a finished one: it must not be asked again.
            self._made.pop(package).destroy()
            self._indefinite = package == "cholmod"
            return False
        if package == "cholmod":
            self.negative = 0
        elif self.symmetric:
            negative, zero, _ = inner.getFactorMatrix().getInertia()
            self.negative = abs(negative - self.saddle) + zero
            self._indefinite = self.negative > 0
        self._current = inner
        return True

    def _upper(self) -> PETSc.Mat:
        """The upper triangle of the matrix, in a format of which CHOLMOD needs no copy: PETSc never frees one when it fails."""
        self.matrix.convert("sbaij", self._half)
        return self._half

    def _create(self, package: str) -> PETSc.PC:
        inner = PETSc.PC().create(self.matrix.comm)
        inner.setOptionsPrefix(prefix := f"bcid_{package}_")
        inner.setType("cholesky" if self.symmetric else "lu")
        inner.setFactorSolverType(package)
        options = PETSc.Options()
        for name, value in _OPTIONS[package].items():
            options[prefix + name] = value
        inner.setFromOptions()
        return inner

    def aim(self, part: float = 0.0, iteration: int = 0) -> bool:
        """Only this part of the residual may be left after a Newton iteration; whether the tangent at hand will do for it.

        Only multigrid has a choice of how accurate it is, see `Multigrid.aim`.
        """
        return self.multigrid is not None and self.multigrid.aim(part, iteration)

    def solve(self, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solve with the last factor. Collective.

        Conjugate gradients that meet negative curvature, or do not converge, leave their last iterate and `negative`
        above zero, or `usable` false: both are seen before the state is accepted.
        """
        if self.multigrid is not None:
            self.multigrid.solve(right, solution)
            if self.multigrid.negative:
                self.negative = 1
            self.usable = not self.multigrid.failed
            return
        assert self._current is not None
        self._current.apply(right, solution)

    def solve_block(self, right: Array, transpose: bool = False) -> Array:
        """Solve for many right-hand sides at once, shape (unknowns, n), with the last factor; one rank only.

        `transpose` solves with the transposed matrix.
        """
        if self.multigrid is not None:
            return self.multigrid.solve_block(right)
        assert self._current is not None
        if transpose:
            solution = np.empty_like(right)
            x, b = self.matrix.createVecs()
            for j in range(right.shape[1]):
                b.array[:] = right[:, j]
                self._current.applyTranspose(b, x)
                solution[:, j] = x.array_r
            x.destroy()
            b.destroy()
            return solution
        stored = np.asfortranarray(right)
        given = PETSc.Mat().createDense(right.shape, array=stored, comm=PETSc.COMM_SELF)
        found = given.duplicate()
        self._current.getFactorMatrix().matSolve(given, found)
        solution = found.getDenseArray().copy()
        given.destroy()
        found.destroy()
        return solution

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        for inner in self._made.values():
            inner.destroy()
        self._made.clear()
        self._half.destroy()
        if self.multigrid is not None:
            self.multigrid.destroy()


def _forget(package: str) -> None:
    """Ask no more for a package that is not there; of options that nothing has used PETSc would complain at its end."""
    _absent.add(package)
    options = PETSc.Options()
    for name in _OPTIONS[package]:
        options.delValue(f"bcid_{package}_{name}")


class FactorShell:
    """What PETSc calls when a `Factor` serves as preconditioner of a Python type.

    Args:
        factor: factorised whenever PETSc says that the matrix has changed.
        correct: solves with it: right-hand side, solution.
    """

    def __init__(self, factor: Factor, correct: Callable[[PETSc.Vec, PETSc.Vec], None]) -> None:
        self.factor, self.correct = factor, correct

    def setUp(self, pc: PETSc.PC) -> None:
        """Factorise; a failure is told to SNES as a failed linear solve, until the next factorisation."""
        ready = self.factor.usable or self.factor.refresh()
        failed = PETSc.PC.FailedReason.FACTOR_NUMERIC_ZEROPIVOT
        pc.setFailedReason(PETSc.PC.FailedReason.NOERROR if ready else failed)

    def apply(self, _pc: PETSc.PC, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solve; PETSc asks although `setUp` failed, and NaN then ends its iteration without an exception.

        An exception would leave its vectors locked for good.
        """
        if self.factor.usable:
            try:
                self.correct(right, solution)
                return
            except PETSc.Error as error:
                self.factor.usable, self.factor.starved = False, error.ierr == OUT_OF_MEMORY
        solution.set(float("nan"))
