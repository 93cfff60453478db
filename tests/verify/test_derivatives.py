"""C4: Taylor tests: what is left of a function without its linear part must fall with the square of the step."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray
from verify.problems import box, crumpled, forces, rates, scene_of, tangent

from bcid.forms import materials
from bcid.forms.mesh.body import Body
from bcid.forms.model import Anchors, Model, Term, pressure, traction
from bcid.forms.solver.equilibrium import Equilibrium

Array = NDArray[np.float64]
SIZE = 0.03
STEPS = 0.5 ** np.arange(4, 9)
NEO = {"young": 15e3, "poisson": 0.35}
FUNG = {"c": 2e3, "bf": 8.0, "bt": 2.0, "bfs": 4.0, "angle": 30.0, "poisson": 0.5}
CASES = {
    "P1": ("neo_hooke", NEO, "displacement", 1, False),
    "P2 with gravity, pressure and traction": ("neo_hooke", NEO, "displacement", 2, True),
    "mixed with gravity, pressure and traction": ("neo_hooke", NEO | {"poisson": 0.5}, "mixed", 2, True),
    "mixed Fung": ("fung", FUNG, "mixed", 2, True),
}


@pytest.fixture(scope="module", params=CASES)
def state(request: pytest.FixtureRequest) -> Iterator[tuple[Equilibrium, Array, Array]]:
    """An equilibrium in a strongly and irregularly deformed state, that state, and a random direction."""
    law, values, formulation, degree, loaded = CASES[request.param]
    model = Model(materials.law(law), values, formulation, down=(0.6, 0.0, -0.8)) + Anchors({"x0"})
    if loaded:
        model = (
            model + Term("gravity", {"weight": 1e4}) + pressure("z0", 500.0) + traction("x1", (100.0, -200.0, 300.0))
        )
    mesh = box((SIZE,) * 3, (2, 2, 2), warp=lambda points: crumpled(points, SIZE, 0.1 * SIZE / 2))
    equilibrium = Equilibrium(Body(MPI.COMM_SELF, mesh, degree, model.mixed), model, scene_of(degree=degree))
    rng = np.random.default_rng(4)
    scale = np.full(equilibrium.body.unknowns, 1e3)  # pressures in Pa, displacements in m
    scale[equilibrium.body.displacement_dofs] = 0.03 * SIZE
    yield equilibrium, scale * rng.uniform(-1, 1, len(scale)), scale * rng.uniform(-1, 1, len(scale))
    equilibrium.destroy()


def at(equilibrium: Equilibrium, values: Array, what: Callable[[Equilibrium], Array]) -> Array:
    equilibrium.u.x.array[:] = values
    return what(equilibrium)


def energy(equilibrium: Equilibrium) -> Array:
    return np.array(equilibrium.energy())


def test_the_tangent_is_the_derivative_of_the_residual(state: tuple[Equilibrium, Array, Array]) -> None:
    equilibrium, u, du = state
    base, slope = at(equilibrium, u, forces), at(equilibrium, u, tangent) @ du
    left = [np.linalg.norm(at(equilibrium, u + h * du, forces) - base - h * slope) for h in STEPS]
    assert rates(left, STEPS) == pytest.approx(2.0, abs=0.05)


def test_the_residual_is_the_derivative_of_the_energy(state: tuple[Equilibrium, Array, Array]) -> None:
    # Surface loads enter the residual as virtual work: their own part is linear in the step (traction) or left out
    # (pressure).
    equilibrium, u, du = state
    if equilibrium.model.terms:
        equilibrium.set_constants(
            {name: 0.0 for name in equilibrium.model.constants() if "pressure on" in name or "traction on" in name}
        )
    base, slope = at(equilibrium, u, energy), at(equilibrium, u, forces) @ du
    left = [abs(at(equilibrium, u + h * du, energy) - base - h * slope) for h in STEPS]
    equilibrium.set_constants(equilibrium.model.constants())
    assert rates(left, STEPS) == pytest.approx(2.0, abs=0.05)


def test_the_tangent_is_symmetric_when_the_model_says_so(state: tuple[Equilibrium, Array, Array]) -> None:
    equilibrium, u, _ = state
    matrix = at(equilibrium, u, tangent)
    skew = abs(matrix - matrix.T).max() / abs(matrix).max()
    assert (skew < 1e-12) == equilibrium.model.symmetric
