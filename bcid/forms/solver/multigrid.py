"""Large meshes: conjugate gradients with algebraic multigrid (GAMG), whose hierarchy outlives the tangent it was made for."""

from __future__ import annotations

import ctypes
import math
import os

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

Array = NDArray[np.float64]
# What PETSc's Python interface leaves out.
_petsc = ctypes.CDLL(PETSc.__file__)
# Weak couplings are left out of the aggregates; one symmetric sweep of SOR needs no estimates of eigenvalues, which
# Chebyshev smoothing makes anew for every tangent; a coarsest level that is not tiny saves levels and iterations.
_OPTIONS: dict[str, int | float | str] = {
    "pc_gamg_threshold": 0.02,
    "pc_gamg_esteig_ksp_max_it": 4,
    "pc_gamg_coarse_eq_limit": 2000,
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "sor",
}
# On one rank MUMPS solves on the coarsest level, with null pivots where small aggregates cannot turn; on several it
# makes all wait for one.
_ALONE: dict[str, int | float | str] = {
    "pc_gamg_coarse_eq_limit": 10_000,
    "mg_coarse_pc_type": "cholesky",
    "mg_coarse_pc_factor_mat_solver_type": "mumps",
    "mg_coarse_mat_mumps_icntl_24": 1,
}
# Galerkin products by way of P^T (A P) take half the time of PETSc's own choice; on shared meshes PETSc knows no such way.
_PRODUCTS = "matptap_via", "rap"
_INDEFINITE = PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT, PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC
# A hierarchy is made anew when a digit takes this many times the iterations that it took at first, and some to begin with.
_WORN, _BEGIN = 2.0, 3
# A Newton correction is solved to this accuracy. Where quadratic convergence can do what is left of the residual at once,
# not less than this part of it, it is solved to what is asked for with some to spare, but no further.
_LOOSE, _WITHIN, _SPARE, _COARSEST = 1e-2, 1e-4, 0.5, 0.1
# Part of what such a correction leaves that is due to the tangent's change. Where it is more, there is one more iteration.
_CHANGED = 0.1
# What is asked of sensitivities, and the most iterations.
_ACCURATE, _PATIENCE = 1e-9, 500


class Multigrid:
    """Solves with a tangent that changes by preconditioning with the hierarchy of an earlier one.

    A fresh hierarchy costs as much as a dozen iterations, a fresh tangent as much as two. So the iteration is always
    that of the present tangent, and the hierarchy stays until it has become a bad preconditioner.

    Args:
        matrix: the tangent; its values may change, its pattern not.
        nodes: places of this rank's nodes, shape (n, 3), m: with them the coarse levels can move rigidly, as they must.

    Attributes:
        accuracy: of the next solves, residual against right-hand side.
        built: hierarchies so far.
        negative: whether the last solve met negative curvature.
        failed: whether it did not converge.
    """

    def __init__(self, matrix: PETSc.Mat, nodes: Array) -> None:
        self.matrix, self.nodes = matrix, nodes
        self.accuracy, self._part = _LOOSE, 0.0
        self.built = 0
        self.negative = self.failed = False
        self._first: float | None = None
        self._new = self._worn = True
        self._krylov = self._create()

    def _create(self) -> PETSc.KSP:
        krylov = PETSc.KSP().create(self.matrix.comm)
        alone = self.matrix.comm.size == 1
        krylov.setOptionsPrefix(prefix := f"bcid_multigrid_{'alone' if alone else 'shared'}_")
        krylov.setType("cg")
        krylov.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        krylov.setOperators(self.matrix)
        krylov.getPC().setType("gamg")
        options = PETSc.Options()
        for name, value in (_OPTIONS | _ALONE if alone else _OPTIONS).items():
            options[prefix + name] = value
        krylov.setFromOptions()
        return krylov

    def aim(self, part: float, iteration: int) -> bool:
        """Solve so accurately that this part of the residual is left, as far as one Newton iteration can get there.

        Tells whether the tangent of the last iteration will do for this one. That has left s of a residual r, most of it
        because its equations were solved loosely, and `_CHANGED` of it, c r^2, because the tangent has changed; with the
        same tangent again it is 2 c r s that this leaves.
        """
        self.accuracy = min(_SPARE * part, _COARSEST) if part > _WITHIN else _LOOSE
        before, self._part = self._part, part
        return iteration > 0 and 2 * _CHANGED * before <= _SPARE * part**2

    def forget(self) -> None:
        """Other nodes are held: the coarse levels no longer know which may move."""
        self._krylov.getPC().reset()
        self._new = self._worn = True

    def update(self) -> None:
        """Take the matrix as it now is. Collective."""
        self._krylov.getPC().setReusePreconditioner(not self._worn)
        self._krylov.setOperators(self.matrix)
        if self._worn:
            self._build()

    def _build(self) -> None:
        hierarchy, options = self._krylov.getPC(), PETSc.Options()
        if self._new:
            hierarchy.setCoordinates(self.nodes)
        alone = self.matrix.comm.size == 1
        # Most memory is taken here: what the mesh, the pattern and the assembly have freed should not be held besides.
        trim()
        if alone:
            options[_PRODUCTS[0]] = _PRODUCTS[1]
        try:
            self._krylov.setUp()
        finally:
            if alone:
                options.delValue(_PRODUCTS[0])
        self._drop_products()
        trim()
        self.built += 1
        self._new, self._worn, self._first = False, False, None

    def _drop_products(self) -> None:
        """Free what PETSc keeps of the Galerkin products for the next time: half of the hierarchy's memory."""
        hierarchy = self._krylov.getPC()
        for level in range(hierarchy.getMGLevels() - 1):
            coarse, _ = hierarchy.getMGSmoother(level).getOperators()
            _petsc.MatProductClear(ctypes.c_void_p(coarse.handle))

    def solve(self, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solve to `accuracy`; `negative` and `failed` tell how it went. Collective."""
        self._krylov.setTolerances(rtol=self.accuracy, max_it=_PATIENCE)
        self._krylov.solve(right, solution)
        reason = self._krylov.getConvergedReason()
        self.negative = reason in _INDEFINITE
        self.failed = reason < 0 and not self.negative
        self._judge()

    def solve_block(self, right: Array) -> Array:
        """Solve accurately for many right-hand sides, shape (this rank's unknowns, n), one after the other. Collective."""
        x, b = self.matrix.createVecs()
        found = np.empty_like(right)
        self.accuracy = _ACCURATE
        for j in range(right.shape[1]):
            b.array[:] = right[:, j]
            self.solve(b, x)
            found[:, j] = np.nan if self.failed else x.array_r
        x.destroy()
        b.destroy()
        return found

    def _judge(self) -> None:
        """Whether the hierarchy has become too old."""
        taken, digits = self._krylov.getIterationNumber(), -math.log10(self.accuracy)
        if self._first is None and taken > 0:
            self._first = taken / digits
        self._worn = self.failed or taken > _WORN * digits * (self._first or 0.0) + _BEGIN

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._krylov.destroy()


def trim() -> bool:
    """Give the pages of this process that nothing uses back to the system; False where its C library has no way to (glibc has).

    Numbering a mesh and finding the pattern of a matrix free as many bytes as they leave, in pieces too small to go back by
    themselves, and what is allocated next is too large to go there.
    """
    found = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    return found is not None and bool(found(ctypes.c_size_t(0)))
