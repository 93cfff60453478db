"""C3: manufactured solution of three-dimensional finite elasticity; the L2 error falls at the order of the elements.

A smooth deformation is chosen, the body force that makes it an equilibrium is derived from the first Piola-Kirchhoff
stress as Bonet & Wood give it (written out below, not taken from bcid), and the boundary is moved as it says. What the
orders are worth is shown by ten deliberate errors in the stress, each of which must spoil them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from numpy.typing import NDArray
from verify.problems import Prescribed, box, integral, rates

from bcid.forms import materials
from bcid.forms.effects.effect import BodyEffect, Point
from bcid.forms.model import Held, Model, Term
from bcid.forms.parameter import Amount
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose

Array = NDArray[np.float64]
YOUNG, POISSON = 15e3, 0.3
MU, LAMBDA = YOUNG / (2 * (1 + POISSON)), YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
AMOUNT = 0.12
VALUES = {"young": YOUNG, "poisson": POISSON}


def exact(X: Any) -> tuple[Any, Any, Any]:
    """The chosen displacement on the unit cube, for UFL."""
    pi = np.pi
    return (
        AMOUNT * (2 * X[0] + X[0] ** 2 + ufl.sin(pi * X[1]) * ufl.cos(pi * X[2] / 2)),
        AMOUNT * (X[0] ** 2 * X[2] + ufl.sin(pi * X[0]) / 2),
        AMOUNT * ufl.cos(pi * X[0]) * X[1],
    )


def exact_field(points: Array) -> Array:
    """The same for numpy."""
    x, y, z = points.T
    pi = np.pi
    return (
        AMOUNT
        * np.c_[2 * x + x**2 + np.sin(pi * y) * np.cos(pi * z / 2), x**2 * z + np.sin(pi * x) / 2, np.cos(pi * x) * y]
    )


def stress(F: Any, mu: Any = MU, lam: Any = LAMBDA) -> Any:
    """First Piola-Kirchhoff stress of the neo-Hookean solid: mu (F - F^-T) + lambda ln J F^-T."""
    inverse = ufl.inv(F).T
    return mu * (F - inverse) + lam * ufl.ln(ufl.det(F)) * inverse


def body_force(point: Point, _c: Any) -> Any:
    """Virtual work of the force that the chosen deformation needs, -Div P; the quadrature adds no error of its own."""
    F = ufl.Identity(3) + ufl.grad(ufl.as_vector(exact(point.X)))
    return ufl.inner(ufl.div(stress(F)), point.v) * ufl.dx(degree=6)


def _errors(F: Any) -> dict[str, Any]:
    """What each deliberate error makes of the stress."""
    inverse, J, I = ufl.inv(F).T, ufl.det(F), ufl.Identity(3)  # noqa: E741
    small = (F + F.T) / 2 - I
    return {
        "sign_of_the_logarithm": MU * (F + inverse) + LAMBDA * ufl.ln(J) * inverse - 2 * MU * I,
        "sign_of_the_pressure": MU * (F - inverse) - LAMBDA * ufl.ln(J) * inverse / 10,
        "lost_volume_term": MU * (F - inverse),
        "lost_factor_of_two": stress(F, mu=MU / 2),
        "transposed_stress": stress(F).T,
        "transposed_inverse": MU * (F - ufl.inv(F)) + LAMBDA * ufl.ln(J) * ufl.inv(F),
        "second_for_first_stress": ufl.inv(F) * stress(F),
        "cauchy_for_first_stress": stress(F) * F.T / J,
        "another_volume_energy": MU * (F - inverse) + LAMBDA * (J - 1) * J * inverse,
        "small_strain": 2 * MU * small + LAMBDA * ufl.tr(small) * I,
        "wrong_modulus": stress(F, lam=YOUNG * POISSON / ((1 + POISSON) * (1 - POISSON))),
    }


ERRORS = tuple(_errors(ufl.Identity(3)))


def mistake(point: Point, c: Any) -> Any:
    """Virtual work of (wrong stress - right stress), for the errors whose constant is 1."""
    F = point.kin.F
    return sum(
        c[name] * ufl.inner(wrong - stress(F), ufl.grad(point.v)) * ufl.dx(degree=4)
        for name, wrong in _errors(F).items()
    )


manufactured = BodyEffect("manufactured", (), "body force of the manufactured solution", work=body_force)
mistakes = BodyEffect(
    "mistakes",
    tuple(Amount(name, "1", "on or off", neutral=0.0) for name in ERRORS),
    "deliberate errors",
    work=mistake,
    symmetric=False,
)


def error(degree: int, divisions: int, wrong: str | None = None, formulation: str = "displacement") -> float:
    """Relative L2 error of the displacement; infinite when no equilibrium is found."""
    model = Model(materials.law("neo_hooke"), VALUES, formulation) + Term(manufactured, {}) + Held("all")
    if wrong is not None:
        model = model + Term(mistakes, {name: float(name == wrong) for name in ERRORS})
    cube = Prescribed.on(box((1.0, 1.0, 1.0), (divisions,) * 3), model, degree)
    cube.field = exact_field
    # The body force has no neutral value, so that the whole of it acts at once; the exact field is close enough to
    # start from.
    start = np.zeros_like(cube.u.x.array)
    start[cube.body.displacement_dofs] = exact_field(cube.body.nodes).ravel()
    status = cube.solve(Pose(), start)
    X = ufl.SpatialCoordinate(cube.body.domain)
    found = ufl.split(cube.u)[0] if cube.body.mixed else cube.u
    difference, whole = found - ufl.as_vector(exact(X)), ufl.as_vector(exact(X))
    result = [integral(ufl.inner(w, w) * ufl.dx(degree=8)) for w in (difference, whole)]
    cube.destroy()
    return float(np.sqrt(result[0] / result[1])) if status is Status.CONVERGED else np.inf


def test_linear_elements_converge_with_order_two() -> None:
    counts = np.array([4, 8, 16])
    observed = rates([error(1, n) for n in counts], 1 / counts)
    assert observed[-1] == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
def test_quadratic_elements_converge_with_order_three() -> None:
    counts = np.array([3, 6, 9])
    observed = rates([error(2, n) for n in counts], 1 / counts)
    assert observed[-1] == pytest.approx(3.0, abs=0.15)


@pytest.mark.slow
def test_cubic_elements_converge_with_order_four() -> None:
    counts = np.array([2, 4, 6])
    observed = rates([error(3, n) for n in counts], 1 / counts)
    assert observed[-1] == pytest.approx(4.0, abs=0.2)


@pytest.mark.slow
def test_the_mixed_formulation_converges_with_order_three() -> None:
    counts = np.array([3, 6])
    observed = rates([error(2, n, formulation="mixed") for n in counts], 1 / counts)
    assert observed[-1] == pytest.approx(3.0, abs=0.15)


@pytest.fixture(scope="module")
def right() -> list[float]:
    """Errors of the right code on the meshes on which the wrong ones are tried."""
    return [error(2, n) for n in (2, 4)]


@pytest.mark.parametrize("wrong", ERRORS)
def test_a_deliberate_error_spoils_the_order(right: list[float], wrong: str) -> None:
    assert rates(right, [1 / 2, 1 / 4])[0] > 2.7
    errors = [error(2, n, wrong) for n in (2, 4)]
    if np.isfinite(errors).all():
        assert rates(errors, [1 / 2, 1 / 4])[0] < 1.5, errors
