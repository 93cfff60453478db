"""scikit-fem as its hyperelasticity example (ex36) writes it: ElementVector(ElementTetP1), forms in NumPy, condense; PARDISO."""

from __future__ import annotations

from validation.bench.peers.problem import LAM, MOST_ITERATIONS, MU, PLACES, RTOL, Clock, arguments, problem

# isort: split
from typing import Any

import numpy as np
import pypardiso
import skfem
from skfem import Basis, BilinearForm, ElementTetP1, ElementVector, LinearForm, MeshTet, condense
from skfem.helpers import ddot, det, grad, inv, mul, transpose


def kinematics(w: Any) -> tuple[Any, Any, Any]:
    """F, det F and its inverse at the quadrature points."""
    F = grad(w["u"]) + np.eye(3)[:, :, None, None]
    return F, det(F), inv(F)


@LinearForm
def internal(v: Any, w: Any) -> Any:
    """Internal forces."""
    F, J, inverse = kinematics(w)
    return ddot(MU * F + (LAM * np.log(J) - MU) * transpose(inverse), grad(v))


@BilinearForm
def tangent(du: Any, v: Any, w: Any) -> Any:
    """Their derivative."""
    _, J, inverse = kinematics(w)
    dF, turned = grad(du), transpose(inverse)
    dP = MU * dF + LAM * ddot(turned, dF) * turned + (MU - LAM * np.log(J)) * mul(mul(turned, transpose(dF)), turned)
    return ddot(dP, grad(v))


def main() -> None:
    """One trajectory."""
    name, field = arguments()
    clock = Clock("scikit-fem, PARDISO", f"scikit-fem {skfem.__version__}")
    data = problem(name)
    mesh = MeshTet(np.ascontiguousarray(data["points"].T), np.ascontiguousarray(data["cells"].T))
    basis = Basis(mesh, ElementVector(ElementTetP1()), intorder=1)
    dofs = basis.nodal_dofs
    grasp = dofs[:, data["patch"]]
    held = np.concatenate([dofs[:, data["fixed"]].ravel(), grasp.ravel()])
    free = basis.complement_dofs(held)
    u = np.zeros(basis.N)
    clock.start()
    for place in PLACES:
        first = None
        count = 0
        while True:
            count += 1
            now = basis.interpolate(u)
            A, b = tangent.assemble(basis, u=now), -internal.assemble(basis, u=now)
            x = np.zeros(basis.N)
            x[grasp] = place[:, None] - u[grasp]
            condensed, right, step, inner = condense(A, b, x=x, D=held)
            if first is None:
                first = np.linalg.norm(right)
            step[inner] = pypardiso.spsolve(condensed.tocsr(), right)
            u = u + step
            if np.linalg.norm(internal.assemble(basis, u=basis.interpolate(u))[free]) <= RTOL * first:
                break
            assert count < MOST_ITERATIONS
        clock.step(count)
    clock.stop()
    clock.finish(field, u[dofs].T)


if __name__ == "__main__":
    main()
