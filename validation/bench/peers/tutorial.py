"""DOLFINx as its hyperelasticity tutorial (J. S. Dokken's book) writes it: UFL energy, NonlinearProblem, Newton, LU by MUMPS.

OpenBLAS comes with the environment. From DOLFINx 0.10 the tutorial's NonlinearProblem is PETSc SNES; both are written here.
"""

from __future__ import annotations

from validation.bench.peers.problem import LAM, MOST_ITERATIONS, MU, PLACES, RTOL, Clock, arguments, in_order, problem

# isort: split
from collections.abc import Callable
from typing import Any

import basix.ufl
import dolfinx
import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc
from mpi4py import MPI
from petsc4py import PETSc

from bcid.base.compat import make_mesh

TANGENT_LU = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


def neo_hooke(u: Any, mu: Any, lam: Any) -> tuple[Any, Any]:
    """The energy density and the first Piola-Kirchhoff stress, as UFL."""
    gradient = ufl.variable(ufl.Identity(3) + ufl.grad(u))
    jacobian = ufl.det(gradient)
    psi = (mu / 2) * (ufl.tr(gradient.T * gradient) - 3 - 2 * ufl.ln(jacobian)) + (lam / 2) * ufl.ln(jacobian) ** 2
    return psi, ufl.diff(psi, gradient)


def newton(
    residual: Any, u: fem.Function, bcs: list[Any], tangent: Any = None, rtol: float = RTOL
) -> Callable[[], int]:
    """A function that solves residual = 0 from the present `u` and returns the number of iterations."""
    try:
        from dolfinx.nls.petsc import NewtonSolver

        nonlinear = petsc.NonlinearProblem(residual, u, bcs, tangent)
    except (ImportError, TypeError):
        return _snes(residual, u, bcs, tangent, rtol)
    solver = NewtonSolver(u.function_space.mesh.comm, nonlinear)
    solver.atol, solver.rtol, solver.convergence_criterion = 1e-14, rtol, "residual"
    solver.max_it = MOST_ITERATIONS
    krylov = solver.krylov_solver
    krylov.setType("preonly")
    krylov.getPC().setType("lu")
    krylov.getPC().setFactorSolverType("mumps")

    def solve() -> int:
        count, converged = solver.solve(u)
        assert converged
        u.x.scatter_forward()
        return int(count)

    return solve


def _snes(residual: Any, u: fem.Function, bcs: list[Any], tangent: Any, rtol: float) -> Callable[[], int]:
    options = {"snes_type": "newtonls", "snes_linesearch_type": "none", "snes_atol": 1e-14, "snes_rtol": rtol}
    options |= {"snes_stol": 0, "snes_max_it": MOST_ITERATIONS}
    nonlinear = petsc.NonlinearProblem(
        residual, u, bcs=bcs, J=tangent, petsc_options_prefix="tutorial_", petsc_options=options | TANGENT_LU
    )

    def solve() -> int:
        nonlinear.solve()
        reason = nonlinear.solver.getConvergedReason()
        if reason <= 0:
            raise RuntimeError(f"Newton solver did not converge: reason {reason}")
        return int(nonlinear.solver.getIterationNumber())

    return solve


def main() -> None:
    """One trajectory."""
    name, field = arguments()
    version = f"dolfinx {dolfinx.__version__}, petsc {'.'.join(map(str, PETSc.Sys.getVersion()))}"
    clock = Clock("DOLFINx, tutorial", version)
    data = problem(name)
    element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    domain = make_mesh(MPI.COMM_SELF, data["cells"], data["points"], element)
    space = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    left, grasp = held(space)
    assert len(left) == len(data["fixed"])
    assert len(grasp) == len(data["patch"])
    place = fem.Constant(domain, default_scalar_type((0, 0, 0)))
    bcs = [
        fem.dirichletbc(np.zeros(3, default_scalar_type), left, space),
        fem.dirichletbc(place, grasp, space),
    ]
    u, v = fem.Function(space), ufl.TestFunction(space)
    _, stress = neo_hooke(u, fem.Constant(domain, MU), fem.Constant(domain, LAM))
    solve = newton(ufl.inner(ufl.grad(v), stress) * ufl.dx, u, bcs)
    clock.start()
    for wanted in PLACES:
        place.value[:] = wanted
        clock.step(solve())
    clock.stop()
    clock.finish(field, in_order(data["points"], space.tabulate_dof_coordinates(), u.x.array.reshape(-1, 3)))


def held(space: Any) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the held face and of the grasp."""
    eps = 1e-6
    left = fem.locate_dofs_geometrical(space, lambda x: x[0] < eps)
    grasp = fem.locate_dofs_geometrical(
        space, lambda x: (x[0] > 80 - eps) & (abs(x[1] - 50) < 10 + eps) & ((x[2] < eps) | (x[2] > 10 - eps))
    )
    return left, grasp


if __name__ == "__main__":
    main()
