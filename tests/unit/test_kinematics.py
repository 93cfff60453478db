"""Kinematics are pure UFL: they are evaluated here with numbers in place of fields, without a mesh."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import ufl
from numpy.typing import NDArray

from bcid.forms.kinematics import Kinematics, expm1
from bcid.scene.parts import horizontal

Matrix = NDArray[np.float64]
AXES = horizontal((0.0, -1.0, 0.0))


def kinematics(H: Matrix) -> Kinematics:
    gradient = ufl.as_matrix(H.tolist())
    return Kinematics(gradient, ufl.Identity(3) + gradient, AXES)


def value(expression: ufl.core.expr.Expr) -> Matrix:
    if expression.ufl_shape == ():
        return np.array(expression(()))
    return np.array([float(expression[index](())) for index in np.ndindex(expression.ufl_shape)]).reshape(
        expression.ufl_shape
    )


@pytest.fixture(params=range(3))
def H(request: pytest.FixtureRequest) -> Matrix:
    return 0.3 * np.random.default_rng(request.param).uniform(-1, 1, (3, 3))


def test_tensors_and_invariants_agree_with_numpy(H: Matrix) -> None:
    kin, F = kinematics(H), np.eye(3) + H
    C = F.T @ F
    J, I1, I2 = np.linalg.det(F), np.trace(C), (np.trace(C) ** 2 - np.trace(C @ C)) / 2
    expected = {
        "F": F, "C": C, "E": (C - np.eye(3)) / 2, "J": J, "lnJ": np.log(J), "I1": I1, "I2": I2, "I3": np.linalg.det(C),
        "I1bar": J ** (-2 / 3) * I1, "I2bar": J ** (-4 / 3) * I2,
        "I1_minus_3": I1 - 3, "I2_minus_3": I2 - 3,
        "I1bar_minus_3": J ** (-2 / 3) * I1 - 3, "I2bar_minus_3": J ** (-4 / 3) * I2 - 3,
    }  # fmt: skip
    for name, number in expected.items():
        np.testing.assert_allclose(value(getattr(kin, name)), number, rtol=1e-12, atol=1e-14, err_msg=name)


def test_fibre_invariants_agree_with_numpy(H: Matrix) -> None:
    kin, F = kinematics(H), np.eye(3) + H
    C, J = F.T @ F, np.linalg.det(F)
    a, b = kin.direction(25.0), kin.direction(-40.0)
    na, nb = value(a), value(b)
    np.testing.assert_allclose(value(kin.invariant4(a)), na @ C @ na, rtol=1e-13)
    np.testing.assert_allclose(value(kin.invariant4_minus_1(a)), na @ C @ na - 1, rtol=1e-12)
    np.testing.assert_allclose(value(kin.invariant4bar_minus_1(a)), J ** (-2 / 3) * na @ C @ na - 1, rtol=1e-12)
    np.testing.assert_allclose(value(kin.invariant5(a)), na @ C @ C @ na, rtol=1e-13)
    np.testing.assert_allclose(value(kin.invariant8(a, b)), na @ C @ nb, rtol=1e-13)


def test_from_gradient_is_the_same_deformation(H: Matrix) -> None:
    F = ufl.as_matrix((np.eye(3) + H).tolist())
    given, built = Kinematics.from_gradient(F, AXES), kinematics(H)
    assert given.F is F
    for name in ("E", "J", "I1bar", "I2bar"):
        np.testing.assert_allclose(value(getattr(given, name)), value(getattr(built, name)), rtol=1e-13, atol=1e-15)


def test_small_strains_keep_their_digits() -> None:
    """I1 - 3 at a strain of 1e-9 is right to 1e-14; formed as a difference it would keep 7 digits."""
    H = 1e-9 * np.random.default_rng(1).uniform(-1, 1, (3, 3))
    exact = [[Fraction(float(x)) for x in row] for row in H]
    i1 = 2 * sum(exact[i][i] for i in range(3)) + sum(x * x for row in exact for x in row)
    kin = kinematics(H)
    assert float(value(kin.I1_minus_3)) == pytest.approx(float(i1), rel=1e-14, abs=0)
    E = [
        [(exact[i][j] + exact[j][i] + sum(exact[k][i] * exact[k][j] for k in range(3))) / 2 for j in range(3)]
        for i in range(3)
    ]
    np.testing.assert_allclose(value(kin.E), [[float(x) for x in row] for row in E], rtol=1e-14)
    assert float(expm1(1e-12)) == pytest.approx(np.expm1(1e-12), rel=1e-15, abs=0)


@pytest.mark.parametrize(
    ("angle", "expected"), [(0, (1, 0, 0)), (90, (0, 0, 1)), (45, (0.5**0.5, 0, 0.5**0.5)), (-90, (0, 0, -1))]
)
def test_a_direction_turns_from_the_first_axis_towards_the_second(
    angle: float, expected: tuple[float, float, float]
) -> None:
    kin = kinematics(np.zeros((3, 3)))
    np.testing.assert_allclose(value(kin.direction(angle)), expected, atol=1e-15)
    other = Kinematics(kin.H, kin.F, ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    x, y, z = expected
    np.testing.assert_allclose(value(other.direction(angle)), (y, x, z), atol=1e-15)


@pytest.mark.parametrize("down", [(0, -1, 0), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0.6, -0.8, 0), (0.995, 0.0998749, 0)])
def test_fibres_lie_in_the_horizontal_plane(down: tuple[float, float, float]) -> None:
    axes = np.array(horizontal(down))
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-6)
    np.testing.assert_allclose(axes @ np.array(down), 0, atol=1e-6)


def test_only_bodies_in_three_dimensions() -> None:
    with pytest.raises(ValueError, match=r"shape \(2, 2\).*expected \(3, 3\)"):
        Kinematics.from_gradient(ufl.Identity(2), AXES)
    with pytest.raises(ValueError, match=r"displacement has shape \(2,\)"):
        Kinematics.of(ufl.as_vector((1.0, 2.0)), AXES)


def test_each_quantity_is_built_once() -> None:
    kin = kinematics(np.zeros((3, 3)))
    assert kin.E is kin.E
    assert kin.J is kin.J
