"""FElupe as its documentation writes it: RegionTetra, NeoHookeCompressible, newtonraphson; the linear solver is MKL's PARDISO."""

from __future__ import annotations

from validation.bench.peers.problem import LAM, MU, PLACES, RTOL, Array, Clock, arguments, problem

# isort: split
from typing import Any

import felupe
import numpy as np
from pypardiso import spsolve


class Criterion:
    """Ends Newton's method at a residual of 1e-8 of the step's first one, as in the other scripts; FElupe's own criterion
    compares with the reactions."""

    def __init__(self) -> None:
        self.first: float | None = None

    def solve(self, A: Any, b: Any, x: Any, dof1: Any, dof0: Any, ext0: Any = None, solver: Any = None) -> Any:
        """FElupe's own linear solve; notes the first residual, with the held nodes' step in it."""
        if self.first is None:
            u = np.concatenate([f.values.ravel() for f in x.fields])
            self.first = float(np.linalg.norm(b[dof1] - A[dof1][:, dof0] @ (ext0 - u[dof0])))
        return felupe.solve.solve(*felupe.solve.partition(x, A, dof1, dof0, -b), ext0, solver=solver)

    def check(self, dx: Any, x: Any, f: Any, xtol: Any, ftol: Any, dof1: Any = None, **_more: Any) -> Any:
        """Norm of the step, norm of the residual, and whether that will do."""
        norm = np.linalg.norm(f[dof1])
        assert self.first is not None
        return np.linalg.norm(dx), norm, bool(norm <= RTOL * self.first)


def main() -> None:
    """One trajectory."""
    name, output = arguments()
    clock = Clock("FElupe, PARDISO", f"felupe {felupe.__version__}")
    data = problem(name)
    points: Array = data["points"]
    mesh = felupe.Mesh(points, data["cells"], "tetra")
    field = felupe.FieldContainer([felupe.Field(felupe.RegionTetra(mesh), dim=3)])
    solid = felupe.SolidBody(umat=felupe.NeoHookeCompressible(mu=MU, lmbda=LAM), field=field)
    masks = {part: np.isin(np.arange(len(points)), data[part]) for part in ("fixed", "patch")}
    bounds = {part: felupe.Boundary(field[0], mask=mask) for part, mask in masks.items()}
    dof0, dof1 = felupe.dof.partition(field, bounds)
    clock.start()
    for place in PLACES:
        held = np.zeros((len(points), 3))
        held[data["patch"]] = place
        criterion = Criterion()
        result = felupe.newtonraphson(
            items=[solid],
            dof0=dof0,
            dof1=dof1,
            ext0=held.ravel()[dof0],
            solver=spsolve,
            solve=criterion.solve,
            check=criterion.check,
            verbose=0,
        )
        assert result.success
        clock.step(result.iterations)
    clock.stop()
    clock.finish(output, field[0].values)


if __name__ == "__main__":
    main()
