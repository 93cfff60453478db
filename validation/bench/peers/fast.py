"""The tutorial with four changes that a user who needs speed makes: a start extrapolated along the motion, a symmetric factor
with one symbolic analysis (MUMPS, PORD ordering), and the quadrature rule of one point, which is exact here.
"""

from __future__ import annotations

from validation.bench.peers.problem import (
    LAM,
    LEG,
    MOST_ITERATIONS,
    MU,
    PLACES,
    RTOL,
    Clock,
    arguments,
    in_order,
    problem,
)

# isort: split
import basix.ufl
import dolfinx
import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc
from mpi4py import MPI
from petsc4py import PETSc

from bcid.base.compat import create_vector, make_mesh
from validation.bench.peers.tutorial import held, neo_hooke

EXTRAPOLATIONS = {1: (1.0,), 2: (2.0, -1.0), 3: (3.0, -3.0, 1.0)}


def main() -> None:
    """One trajectory."""
    name, field = arguments()
    version = f"dolfinx {dolfinx.__version__}, petsc {'.'.join(map(str, PETSc.Sys.getVersion()))}"
    clock = Clock("DOLFINx, fast", version)
    data = problem(name)
    element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    domain = make_mesh(MPI.COMM_SELF, data["cells"], data["points"], element)
    space = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    left, grasp = held(space)
    place = fem.Constant(domain, default_scalar_type((0, 0, 0)))
    bcs = [
        fem.dirichletbc(np.zeros(3, default_scalar_type), left, space),
        fem.dirichletbc(place, grasp, space),
    ]
    u, v = fem.Function(space), ufl.TestFunction(space)
    _, stress = neo_hooke(u, fem.Constant(domain, MU), fem.Constant(domain, LAM))
    residual = ufl.inner(ufl.grad(v), stress) * ufl.dx(metadata={"quadrature_degree": 0})
    residual_form, tangent_form = fem.form(residual), fem.form(ufl.derivative(residual, u))
    matrix, b = petsc.create_matrix(tangent_form), create_vector(residual_form)
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    krylov = PETSc.KSP().create(MPI.COMM_SELF)
    krylov.setType("preonly")
    krylov.setOperators(matrix)
    krylov.getPC().setType("cholesky")
    krylov.getPC().setFactorSolverType("mumps")
    PETSc.Options()["mat_mumps_icntl_7"] = 4
    krylov.setFromOptions()
    x, correction, values = u.x.petsc_vec, b.duplicate(), u.x.array
    moved = (3 * grasp[:, None] + np.arange(3)).ravel()
    bound = np.concatenate([moved, (3 * left[:, None] + np.arange(3)).ravel()])

    def imbalance(lifted: bool) -> float:
        """Assemble the residual; with `lifted` the step of the held nodes is still to be made and stands in it."""
        with b.localForm() as local:
            local.set(0.0)
        petsc.assemble_vector(b, residual_form)
        if lifted:
            petsc.apply_lifting(b, [tangent_form], [bcs], [x], -1.0)
            petsc.set_bc(b, bcs, x, -1.0)
        else:
            b.array[bound] = 0.0
        return float(np.sqrt(max(0.0, b.array @ b.array - b.array[bound] @ b.array[bound])))

    clock.start()
    history = [values.copy()]
    scale = 0.0
    for k, wanted in enumerate(PLACES):
        place.value[:] = wanted
        # A leg starts in a new direction: its first step is lifted, and gives the scale of the others.
        lifted = k % LEG == 0
        if lifted:
            norm = scale = imbalance(True)
        else:
            known = min(1 + k % LEG, 3)
            values[:] = sum(c * h for c, h in zip(EXTRAPOLATIONS[known], history[::-1], strict=False))
            values[moved] = np.tile(wanted, len(grasp))
            norm = imbalance(False)
        count = 0
        while (lifted and count == 0) or norm > RTOL * scale:
            matrix.zeroEntries()
            petsc.assemble_matrix(matrix, tangent_form, bcs)
            matrix.assemble()
            krylov.setOperators(matrix)
            krylov.solve(b, correction)
            x.axpy(-1.0, correction)
            count += 1
            assert count < MOST_ITERATIONS
            norm = imbalance(False)
        clock.step(count)
        history = [*history, values.copy()][-3:]
    clock.stop()
    clock.finish(field, in_order(data["points"], space.tabulate_dof_coordinates(), values.reshape(-1, 3)))


if __name__ == "__main__":
    main()
