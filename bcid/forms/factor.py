"""The factorised tangent: a PETSc preconditioner that knows whether the matrix was positive definite."""

from __future__ import annotations

from itertools import count

from petsc4py import PETSc

_prefixes = count()
# CHOLMOD must not print; MUMPS: PORD ordering suits these meshes, the root stays sequential and null pivots are looked for, so that
# the signs are counted right.
_OPTIONS = {
    "cholmod": {"mat_cholmod_print": 0},
    "mumps": {"mat_mumps_icntl_7": 4, "mat_mumps_icntl_13": 1, "mat_mumps_icntl_24": 1},
}


class Factor:
    """Direct factorisation of the tangent, with the sign of its pivots; SNES uses it through a `FactorShell`.

    CHOLMOD, the fastest here on one rank, stops at a pivot that is not positive; then, on shared meshes, and for the saddle points of
    the mixed formulation, MUMPS takes over (LDL^T), which counts the negative pivots. A tangent that is not symmetric gets MUMPS' LU,
    which knows no signs.

    Args:
        matrix: the assembled tangent.
        symmetric: whether it is symmetric.
        saddle: number of pressures: this many negative pivots are right.

    Attributes:
        count: factorisations so far.
        usable: whether the last one succeeded and nobody has declared it stale since.
        negative: how many pivots are negative beyond `saddle`; None when it is not known.
    """

    def __init__(self, matrix: PETSc.Mat, symmetric: bool = True, saddle: int = 0) -> None:
        self.matrix = matrix
        self.symmetric = symmetric
        self.saddle = saddle
        self.count = 0
        self.usable = False
        self.negative: int | None = None
        self._definite = symmetric and not saddle and matrix.comm.size == 1
        self._made: dict[str, PETSc.PC] = {}
        self._current: PETSc.PC | None = None

    def refresh(self) -> bool:
        """Factorise the matrix as it now is; False when that fails. Collective."""
        self.count += 1
        self.negative = None
        self.usable = (self._definite and self._factorise("cholmod")) or self._factorise("mumps")
        return self.usable

    def _factorise(self, package: str) -> bool:
        if package not in self._made:
            self._made[package] = self._create(package)
        inner = self._made[package]
        try:
            inner.setOperators(self.matrix)
            inner.setUp()
        except PETSc.Error:
            # PETSc takes a factorisation that has failed for a finished one: it must not be asked again.
            self._made.pop(package).destroy()
            return False
        if inner.getFailedReason() != PETSc.PC.FailedReason.NOERROR:
            return False
        if package == "cholmod":
            self.negative = 0
        elif self.symmetric:
            negative, zero, _ = inner.getFactorMatrix().getInertia()
            self.negative = abs(negative - self.saddle) + zero
        self._current = inner
        return True

    def _create(self, package: str) -> PETSc.PC:
        inner = PETSc.PC().create(self.matrix.comm)
        inner.setOptionsPrefix(prefix := f"bcid_factor_{next(_prefixes)}_")
        inner.setType("cholesky" if self.symmetric else "lu")
        inner.setFactorSolverType(package)
        options = PETSc.Options()
        for name, value in _OPTIONS[package].items():
            options[prefix + name] = value
        inner.setFromOptions()
        return inner

    def solve(self, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solve with the last factor. Collective."""
        assert self._current is not None
        self._current.apply(right, solution)

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        for inner in self._made.values():
            inner.destroy()
        self._made.clear()


class FactorShell:
    """What PETSc calls when a `Factor` serves as preconditioner of a Python type."""

    def __init__(self, factor: Factor) -> None:
        self.factor = factor

    def setUp(self, pc: PETSc.PC) -> None:
        """Factorise; a failure is told to SNES as a failed linear solve."""
        if not self.factor.refresh():
            pc.setFailedReason(PETSc.PC.FailedReason.FACTOR_NUMERIC_ZEROPIVOT)

    def apply(self, _pc: PETSc.PC, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solve with the factor."""
        self.factor.solve(right, solution)
