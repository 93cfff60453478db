"""C2: the patch test. A boundary moved affinely must move the inside affinely, however crumpled the mesh is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from verify.problems import Prescribed, box, crumpled, out_of_balance

from bcid.forms import materials
from bcid.forms.model import Held, Model
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose

SIZE = 0.03
DEFORMATIONS = 50


@pytest.fixture(scope="module", params=["P1", "P2", "mixed"])
def cube(request: pytest.FixtureRequest) -> Iterator[Prescribed]:
    mesh = box((SIZE,) * 3, (3, 3, 3), warp=lambda points: crumpled(points, SIZE, 0.15 * SIZE / 3))
    formulation = "mixed" if request.param == "mixed" else "displacement"
    model = Model(materials.law("neo_hooke"), {"young": 15e3, "poisson": 0.35}, formulation) + Held("all")
    equilibrium = Prescribed.on(mesh, model, 1 if request.param == "P1" else 2, rtol=1e-13)
    yield equilibrium
    equilibrium.destroy()


@pytest.mark.parametrize("seed", range(DEFORMATIONS))
def test_affine_boundary_gives_the_affine_field(cube: Prescribed, seed: int) -> None:
    rng = np.random.default_rng(seed)
    gradient = rng.uniform(-0.3, 0.3, (3, 3))
    assert np.linalg.det(np.eye(3) + gradient) > 0.1
    cube.field = lambda points: points @ gradient.T
    cube.reset()
    exact = cube.field(cube.body.nodes)
    # Newton starts from the affine field with its inside shaken, so that it has something to do.
    start = np.zeros_like(cube.u.x.array)
    start[cube.body.displacement_dofs] = exact.ravel()
    inside = np.isin(cube.body.displacement_dofs, cube.supports.prescribed, invert=True)
    start[cube.body.displacement_dofs[inside]] += rng.uniform(-0.01, 0.01, inside.sum()) * SIZE
    before = cube.iterations
    assert cube.solve(Pose(), start) is Status.CONVERGED
    assert cube.iterations > before
    assert np.abs(cube.displacement() - exact).max() <= 1e-10 * np.abs(exact).max()
    assert out_of_balance(cube) <= 1e-10
