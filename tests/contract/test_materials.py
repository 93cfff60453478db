"""What every material law has to keep, and its numbers against formulas written out by hand in numpy.

The laws are found by name, so that a new file is tested as soon as it exists; it only needs a case here.
"""

from __future__ import annotations

import doctest
import importlib
import math
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.base.units import parse_unit
from bcid.forms import materials
from bcid.forms.kinematics import Kinematics
from bcid.forms.materials import neo_hooke
from bcid.forms.parameter import Parameter
from bcid.scene.parts import horizontal

Array = NDArray[np.float64]
Values = Mapping[str, float]

# compiling dominates this file: no optimisation
JIT = {"cffi_extra_compile_args": ["-O0"]}
I3 = np.eye(3)
AXES = horizontal((0.0, -1.0, 0.0))


# ---------------------------------------------------------------- closed forms, by hand


def _bulk(mu: float, nu: float) -> float:
    return 2 * mu * (1 + nu) / 3 / (1 - 2 * nu)


def _lame(mu: float, nu: float) -> float:
    return 2 * mu * nu / (1 - 2 * nu)


def _isotropic(kirchhoff: Callable[[Array, Values], Array]) -> Callable[[Array, Values], Array]:
    """First Piola-Kirchhoff stress of an isotropic law from its principal Kirchhoff stresses tau_i(stretches)."""

    def stress(F: Array, v: Values) -> Array:
        left, stretch, right = np.linalg.svd(F)
        return left @ np.diag(kirchhoff(stretch, v) / stretch) @ right

    return stress


def _isochoric(stretch: Array) -> tuple[Array, float]:
    volume = float(np.prod(stretch))
    return stretch / volume ** (1 / 3), math.log(volume)


def _first_invariant_law(slope: Callable[[float, Values], float], shear: Callable[[Values], float]) -> Any:
    """tau_i of psi(I1bar) + K/2 (ln J)^2, slope = psi'(I1bar - 3)."""

    def kirchhoff(stretch: Array, v: Values) -> Array:
        s, lnJ = _isochoric(stretch)
        i1 = float(np.sum(s**2))
        return 2 * slope(i1 - 3, v) * (s**2 - i1 / 3) + _bulk(shear(v), v["poisson"]) * lnJ

    return _isotropic(kirchhoff)


def _neo_hooke(stretch: Array, v: Values) -> Array:
    mu = v["young"] / 2 / (1 + v["poisson"])
    return mu * (stretch**2 - 1) + _lame(mu, v["poisson"]) * math.log(np.prod(stretch))


def _saint_venant_kirchhoff(stretch: Array, v: Values) -> Array:
    mu = v["young"] / 2 / (1 + v["poisson"])
    strain = (stretch**2 - 1) / 2
    return stretch**2 * (2 * mu * strain + _lame(mu, v["poisson"]) * np.sum(strain))


def _mooney_rivlin(stretch: Array, v: Values) -> Array:
    s, lnJ = _isochoric(stretch)
    first, second = s**2 - np.mean(s**2), s**-2 - np.mean(s**-2)
    return 2 * v["c10"] * first - 2 * v["c01"] * second + _bulk(2 * (v["c10"] + v["c01"]), v["poisson"]) * lnJ


def _ogden_terms(v: Values) -> list[tuple[float, float]]:
    return [(v[f"mu{p}"], v[f"alpha{p}"]) for p in (1, 2, 3)]


def _ogden(stretch: Array, v: Values) -> Array:
    s, lnJ = _isochoric(stretch)
    shear = sum(mu * alpha for mu, alpha in _ogden_terms(v)) / 2
    terms = [mu * (s**alpha - np.mean(s**alpha)) for mu, alpha in _ogden_terms(v)]
    return np.sum(terms, axis=0) + _bulk(shear, v["poisson"]) * lnJ


def _fung(F: Array, v: Values) -> Array:
    angle = math.radians(v["angle"])
    basis = np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
    strain = basis @ ((F.T @ F - I3) / 2) @ basis.T
    weight = np.array([[v["bf"], v["bfs"], v["bfs"]], [v["bfs"], v["bt"], v["bt"]], [v["bfs"], v["bt"], v["bt"]]])
    S = v["c"] * math.exp(np.sum(weight * strain**2)) * weight * strain
    bulk = _lame(v["c"] * (2 * v["bfs"] + v["bt"]) / 6, v["poisson"])
    return F @ basis.T @ S @ basis + bulk * math.log(np.linalg.det(F)) * np.linalg.inv(F).T


def _holzapfel_gasser_ogden(F: Array, v: Values) -> Array:
    matrix = _first_invariant_law(lambda x, v: v["mu"] / 2, lambda v: v["mu"])
    stress: Array = matrix(F, v)
    for angle in (math.radians(v["angle"]), -math.radians(v["angle"])):
        a = np.array([math.cos(angle), 0, math.sin(angle)])
        e = v["kappa"] * (np.sum(F**2) - 3) + (1 - 3 * v["kappa"]) * (np.sum((F @ a) ** 2) - 1)
        assert e <= 0 or e >= 0.01, "the formula holds outside the smooth start only"
        slope = v["k1"] * max(e, 0) * math.exp(v["k2"] * e**2)
        stress = stress + slope * (2 * v["kappa"] * F + 2 * (1 - 3 * v["kappa"]) * np.outer(F @ a, a))
    return stress


def _yeoh_slope(x: float, v: Values) -> float:
    return v["c1"] + 2 * v["c2"] * x + 3 * v["c3"] * x**2


def _gent_slope(x: float, v: Values) -> float:
    return v["mu"] / 2 * v["jm"] / (v["jm"] - x)


def _demiray_slope(x: float, v: Values) -> float:
    return v["mu"] / 2 * math.exp(v["b"] * x)


# ---------------------------------------------------------------- incompressible bar, textbook formulas


def _bar_first_invariant(slope: Callable[[float, Values], float]) -> Callable[[float, Values], float]:
    return lambda s, v: 2 * (s - s**-2) * slope(s**2 + 2 / s - 3, v)


def _bar_fung(s: float, v: Values) -> float:
    along, across = (s**2 - 1) / 2, (1 / s - 1) / 2
    scale = v["c"] * math.exp(v["bf"] * along**2 + 2 * v["bt"] * across**2)
    return scale * (v["bf"] * along * s - v["bt"] * across / s**2)


def _bar_holzapfel(s: float, v: Values) -> float:
    kappa = v["kappa"]
    e = kappa * (s**2 + 2 / s - 3) + (1 - 3 * kappa) * (s**2 - 1)
    slope = 2 * v["k1"] * max(e, 0) * math.exp(v["k2"] * e**2)
    return v["mu"] * (s - s**-2) + 2 * slope * ((1 - 2 * kappa) * s - kappa / s**2)


# ---------------------------------------------------------------- cases


@dataclass(frozen=True)
class Case:
    """Values to test a law with, its stress by hand, and the rotations its energy does not see."""

    values: dict[str, float]
    stress: Callable[[Array, Values], Array]
    bar: Callable[[float, Values], float] | None = None
    symmetry: str = "isotropic"
    hooke: dict[str, float] | None = None
    """changes that make the law Hooke's solid at rest"""


CASES: dict[str, Case] = {
    "neo_hooke": Case(
        {"young": 15e3, "poisson": 0.35},
        _isotropic(_neo_hooke),
        lambda s, v: v["young"] / 3 * (s - s**-2),
    ),
    "saint_venant_kirchhoff": Case({"young": 15e3, "poisson": 0.35}, _isotropic(_saint_venant_kirchhoff)),
    "mooney_rivlin": Case(
        {"c10": 2e3, "c01": 5e2, "poisson": 0.4},
        _isotropic(_mooney_rivlin),
        lambda s, v: 2 * (s - s**-2) * (v["c10"] + v["c01"] / s),
    ),
    "yeoh": Case(
        {"c1": 2.5e3, "c2": 400.0, "c3": 50.0, "poisson": 0.45},
        _first_invariant_law(_yeoh_slope, lambda v: 2 * v["c1"]),
        _bar_first_invariant(_yeoh_slope),
    ),
    "gent": Case(
        {"mu": 5e3, "jm": 6.0, "poisson": 0.45},
        _first_invariant_law(_gent_slope, lambda v: v["mu"]),
        _bar_first_invariant(_gent_slope),
    ),
    "demiray": Case(
        {"mu": 5e3, "b": 1.2, "poisson": 0.45},
        _first_invariant_law(_demiray_slope, lambda v: v["mu"]),
        _bar_first_invariant(_demiray_slope),
    ),
    "ogden": Case(
        {"mu1": 600.0, "alpha1": 8.0, "mu2": -300.0, "alpha2": -3.0, "mu3": 100.0, "alpha3": 1.3, "poisson": 0.45},
        _isotropic(_ogden),
        lambda s, v: sum(mu * (s ** (alpha - 1) - s ** (-alpha / 2 - 1)) for mu, alpha in _ogden_terms(v)),
    ),
    "fung": Case(
        {"c": 2e3, "bf": 8.0, "bt": 2.0, "bfs": 4.0, "angle": 30.0, "poisson": 0.4},
        _fung,
        _bar_fung,
        symmetry="about the fibre",
        hooke={"bf": 3.0, "bt": 3.0, "bfs": 3.0},
    ),
    "holzapfel_gasser_ogden": Case(
        {"mu": 3e3, "k1": 5e3, "k2": 2.0, "angle": 30.0, "kappa": 0.1, "poisson": 0.45},
        _holzapfel_gasser_ogden,
        _bar_holzapfel,
        symmetry="half turns",
    ),
}

every_law = pytest.mark.parametrize("name", materials.names())
every_mixed_law = pytest.mark.parametrize("name", [n for n in materials.names() if materials.law(n).bulk is not None])


def test_every_law_has_a_case() -> None:
    missing = set(materials.names()) - set(CASES)
    assert not missing, f"add a Case with values and a hand-written stress for {missing}"


# ---------------------------------------------------------------- evaluation at a point and on a mesh


@cache
def cube() -> mesh.Mesh:
    return mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)


class Point:
    """Energy and first Piola-Kirchhoff stress of a law under a uniform deformation, compiled once."""

    def __init__(self, name: str, volumetric: Any = None, mixed: bool = False) -> None:
        self.name = name
        law = materials.law(name)
        self.F = fem.Constant(cube(), I3)
        self.p = fem.Constant(cube(), np.float64(0))
        self.c = {p.name: fem.Constant(cube(), np.float64(0)) for p in law.parameters}
        F, p, poisson = ufl.variable(self.F), ufl.variable(self.p), ufl.variable(self.c["poisson"])
        kin, c = Kinematics.from_gradient(F, AXES), {**self.c, "poisson": poisson}
        W = law.psi_mixed(kin, p, c, volumetric) if mixed else law.psi(kin, c, volumetric)
        P = ufl.diff(W, F)
        extra = [ufl.diff(W, p), ufl.diff(W, poisson)] if mixed else []
        vector = ufl.as_vector([W, *(P[i, j] for i in range(3) for j in range(3)), *extra])
        self.expression = fem.Expression(vector, np.full((1, 3), 0.25), jit_options=JIT)

    def __call__(self, F: Array, values: Values | None = None, p: float = 0.0) -> tuple[float, Array, Array]:
        """Energy, stress and (if mixed) the derivatives by pressure and poisson."""
        full = materials.law(self.name).complete(CASES[self.name].values if values is None else values)
        for key, constant in self.c.items():
            constant.value = full[key]
        self.F.value[:], self.p.value = F, p
        result = np.asarray(self.expression.eval(cube(), np.array([0], dtype=np.int32))).ravel()
        return float(result[0]), result[1:10].reshape(3, 3), result[10:]


point = cache(Point)


class Body:
    """A unit cube of linear tetrahedra: energy, residual and tangent assembled from the law's energy."""

    def __init__(self, name: str) -> None:
        law = materials.law(name)
        V = fem.functionspace(cube(), ("Lagrange", 1, (3,)))
        self.x = V.tabulate_dof_coordinates()
        self.u = fem.Function(V)
        self.law = law
        self.c = {p.name: fem.Constant(cube(), np.float64(0)) for p in law.parameters}
        energy = law.psi(Kinematics.of(self.u, AXES), self.c) * ufl.dx(metadata={"quadrature_degree": 1})
        residual = ufl.derivative(energy, self.u, ufl.TestFunction(V))
        tangent = ufl.derivative(residual, self.u, ufl.TrialFunction(V))
        self.forms = [fem.form(f, jit_options=JIT) for f in (energy, residual, tangent)]
        self.set(CASES[name].values)

    def set(self, values: Values) -> None:
        for key, value in self.law.complete(values).items():
            self.c[key].value = value

    def energy(self, u: Array) -> float:
        self.u.x.array[:] = u
        return float(fem.assemble_scalar(self.forms[0]))

    def residual(self, u: Array) -> Array:
        self.u.x.array[:] = u
        return np.array(fem.assemble_vector(self.forms[1]).array)

    def tangent(self, u: Array) -> Array:
        self.u.x.array[:] = u
        return np.asarray(fem.assemble_matrix(self.forms[2]).to_dense())

    def elasticity(self, F: Array) -> Array:
        """dP/dF (3 x 3 x 3 x 3) under a uniform deformation: the tangent between affine fields, volume 1."""
        affine = np.array([np.outer(self.x[:, j], I3[i]).ravel() for i in range(3) for j in range(3)])
        K = self.tangent((F - I3).ravel() @ affine)
        return np.asarray((affine @ K @ affine.T).reshape(3, 3, 3, 3))


body = cache(Body)


def shear_of(name: str) -> float:
    law = materials.law(name)
    return float(law.shear(law.complete(CASES[name].values)))


def rotation(rng: np.random.Generator) -> Array:
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return Q * np.sign(np.linalg.det(Q))


def turn(axis: Array, angle: float) -> Array:
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return I3 + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def deformations(count: int, seed: int = 7) -> list[Array]:
    rng = np.random.default_rng(seed)
    return [I3 + 0.3 * rng.uniform(-1, 1, (3, 3)) for _ in range(count)]


def symmetry(name: str, rng: np.random.Generator) -> Array:
    """A rotation of the material before it is deformed that its energy must not see."""
    case = CASES[name]
    if case.symmetry == "isotropic":
        return rotation(rng)
    if case.symmetry == "half turns":
        return turn(I3[rng.integers(3)], math.pi)
    angle = math.radians(case.values["angle"])
    return turn(np.array([math.cos(angle), 0, math.sin(angle)]), rng.uniform(0, 2 * math.pi))


# ---------------------------------------------------------------- contract of the energy


@every_law
def test_rest_and_rotation_cost_nothing(name: str) -> None:
    mu = shear_of(name)
    energy, stress, _ = point(name)(I3)
    assert abs(energy) < 1e-15 * mu
    assert np.abs(stress).max() < 1e-15 * mu
    for seed in range(5):
        energy, stress, _ = point(name)(rotation(np.random.default_rng(seed)))
        assert abs(energy) < 1e-14 * mu
        assert np.abs(stress).max() < 3e-14 * mu


@every_law
def test_energy_does_not_see_a_rotation_of_the_laboratory(name: str) -> None:
    rng = np.random.default_rng(11)
    for F in deformations(50):
        energy = point(name)(F)[0]
        assert point(name)(rotation(rng) @ F)[0] == pytest.approx(energy, rel=1e-13)


@every_law
def test_energy_keeps_the_symmetry_of_the_material(name: str) -> None:
    rng = np.random.default_rng(12)
    changed = 0.0
    for F in deformations(20):
        energy = point(name)(F)[0]
        assert point(name)(F @ symmetry(name, rng))[0] == pytest.approx(energy, rel=1e-12)
        changed = max(changed, abs(point(name)(F @ rotation(rng))[0] / energy - 1))
    assert (changed > 0.01) == (CASES[name].symmetry != "isotropic"), "fibres must be felt, and only fibres"


@every_law
def test_energy_grows_away_from_rest(name: str) -> None:
    assert all(point(name)(F)[0] > 0 for F in deformations(50))
    pull = [point(name)(np.diag((s, 1.0, 1.0)))[0] for s in (1.0, 1.1, 1.2, 1.4, 1.7)]
    assert np.all(np.diff(pull) > 0)
    if name != "saint_venant_kirchhoff":
        squeeze = [point(name)(s * I3)[0] for s in (0.9, 0.5, 1e-1, 1e-2, 1e-4)]
        assert np.all(np.diff(squeeze) > 0)


@every_law
def test_stress_equals_the_formula_written_by_hand(name: str) -> None:
    """Uniaxial, equibiaxial, simple shear, swelling, general."""
    shear = I3 + 0.4 * np.outer(I3[0], I3[1])
    states = [np.diag((1.4, 0.85, 0.85)), np.diag((0.7, 1.15, 1.15)), np.diag((1.2, 0.7, 1.2)), shear, 1.1 * I3]
    for F in [*states, *deformations(10, seed=3)]:
        expected = CASES[name].stress(F, CASES[name].values)
        np.testing.assert_allclose(point(name)(F)[1], expected, rtol=1e-9, atol=1e-9 * shear_of(name), err_msg=str(F))


@every_law
def test_residual_and_tangent_pass_the_taylor_test(name: str) -> None:
    """Energy to residual and residual to tangent: the remainder falls with the square of the step."""
    b, rng = body(name), np.random.default_rng(5)
    u, du = 0.2 * rng.uniform(-1, 1, b.x.size), rng.uniform(-1, 1, b.x.size)
    steps = 1e-3 * 0.5 ** np.arange(4)
    W, R, K = b.energy(u), b.residual(u), b.tangent(u)
    first = np.array([abs(b.energy(u + h * du) - W - h * R @ du) for h in steps])
    second = np.array([np.linalg.norm(b.residual(u + h * du) - R - h * K @ du) for h in steps])
    for remainder in (first, second):
        np.testing.assert_allclose(np.log2(remainder[:-1] / remainder[1:]), 2.0, atol=0.05)
    np.testing.assert_allclose(K, K.T, atol=1e-9 * np.abs(K).max())


@every_law
def test_small_strains_are_hookes_with_the_stated_shear_modulus_and_poisson(name: str) -> None:
    values = {**CASES[name].values, **(CASES[name].hooke or {})}
    b = body(name)
    b.set(values)
    elasticity = b.elasticity(I3)
    b.set(CASES[name].values)
    mu = float(b.law.shear(b.law.complete(values)))
    lame = _lame(mu, values["poisson"])
    square = np.einsum("ik,jl->ijkl", I3, I3)
    hooke = lame * np.einsum("ij,kl->ijkl", I3, I3) + mu * (square + np.einsum("il,jk->ijkl", I3, I3))
    np.testing.assert_allclose(elasticity, hooke, atol=1e-9 * mu)


def test_fung_shear_modulus_is_the_mean_over_the_three_planes() -> None:
    elasticity = body("fung").elasticity(I3)
    moduli = [elasticity[0, 1, 0, 1], elasticity[1, 2, 1, 2], elasticity[0, 2, 0, 2]]
    body("fung").set({**CASES["fung"].values, "angle": 0.0})
    straight = body("fung").elasticity(I3)
    body("fung").set(CASES["fung"].values)
    c, bt, bfs = (CASES["fung"].values[key] for key in ("c", "bt", "bfs"))
    assert [straight[i, j, i, j] for i, j in ((0, 1), (0, 2), (1, 2))] == pytest.approx(
        [c * bfs / 2] * 2 + [c * bt / 2]
    )
    assert np.mean([straight[i, j, i, j] for i, j in ((0, 1), (0, 2), (1, 2))]) == pytest.approx(shear_of("fung"))
    assert moduli[0] != pytest.approx(straight[0, 1, 0, 1], rel=0.01), "the angle turns the fibres"


# ---------------------------------------------------------------- volume change and the mixed form


@pytest.mark.parametrize(
    ("form", "energy"),
    [
        ("log", lambda J: math.log(J) ** 2 / 2),
        ("simo_taylor", lambda J: (J**2 - 1 - 2 * math.log(J)) / 4),
        ("quadratic", lambda J: (J - 1) ** 2 / 2),
    ],
)
def test_volumetric_energies(form: str, energy: Callable[[float], float]) -> None:
    values = CASES["yeoh"].values
    for stretch in (0.8, 1.0, 1.3):
        expected = _bulk(2 * values["c1"], values["poisson"]) * energy(stretch**3)
        assert point("yeoh", form)(stretch * I3)[0] == pytest.approx(expected, rel=1e-12, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "form"),
    [*((n, "log") for n in materials.names() if materials.law(n).bulk is not None), ("yeoh", "quadratic")],
)
def test_mixed_form_is_the_displacement_form_once_the_pressure_is_eliminated(name: str, form: str) -> None:
    law = materials.law(name)
    assert law.bulk is not None
    assert law.compliance is not None
    full = law.complete(CASES[name].values)
    assert law.bulk(full) * law.compliance(full) == pytest.approx(1.0, rel=1e-14, abs=0)
    for F in deformations(5):
        J = float(np.linalg.det(F))
        p = law.bulk(full) * (math.log(J) if form == "log" else J - 1)
        energy, stress, slopes = point(name, form, mixed=True)(F, p=p)
        plain, plain_stress, _ = point(name, form)(F)
        assert energy == pytest.approx(plain, rel=1e-12)
        np.testing.assert_allclose(stress, plain_stress, rtol=1e-11, atol=1e-11 * shear_of(name))
        assert abs(slopes[0]) < 1e-13


@every_mixed_law
def test_incompressible_bar_has_the_textbook_stress(name: str) -> None:
    """poisson = 0.5: no compliance, nothing that is not a number, also in the derivative by poisson."""
    law, case = materials.law(name), CASES[name]
    values = {**case.values, "poisson": 0.5, **({"angle": 0.0} if "angle" in case.values else {})}
    assert law.compliance is not None
    assert law.compliance(law.complete(values)) == 0
    assert law.check(values, mixed=True) == []
    assert case.bar is not None
    for stretch in (0.8, 1.0, 1.25, 1.6):
        F = np.diag((stretch, stretch**-0.5, stretch**-0.5))
        p = -point(name, "log", mixed=True)(F, values)[1][1, 1] * F[1, 1]
        energy, stress, slopes = point(name, "log", mixed=True)(F, values, p=p)
        assert np.isfinite([energy, *slopes]).all()
        assert stress[0, 0] == pytest.approx(case.bar(stretch, values), rel=1e-9, abs=1e-9 * shear_of(name))
        assert abs(stress[1, 1]) < 1e-9 * shear_of(name)
    assert point(name, "log", mixed=True)(I3, values, p=1.0)[2][1] > 0, "more room to compress as poisson falls"


def test_mixed_form_is_refused_where_it_does_not_exist() -> None:
    kin = Kinematics.from_gradient(ufl.Identity(3), AXES)
    with pytest.raises(InputError, match="'simo_taylor' has no mixed formulation; allowed: log, quadratic"):
        materials.law("yeoh").psi_mixed(kin, 1.0, CASES["yeoh"].values, "simo_taylor")
    with pytest.raises(InputError, match="'saint_venant_kirchhoff' has no separate volumetric energy"):
        materials.law("saint_venant_kirchhoff").psi_mixed(kin, 1.0, CASES["saint_venant_kirchhoff"].values)
    with pytest.raises(InputError, match="unknown volumetric energy 'cubic'; allowed: log, simo_taylor, quadratic"):
        materials.law("yeoh").psi(kin, CASES["yeoh"].values, "cubic")  # type: ignore[arg-type]


# ---------------------------------------------------------------- what is special to one law


def _ogden_elasticity(stretch: Array, v: Values) -> Array:
    """dP/dF of an isotropic law under diag(stretch), with the limits for equal stretches (Ogden 1997, sec. 6.1.4)."""
    s, _ = _isochoric(stretch)
    shear = sum(mu * alpha for mu, alpha in _ogden_terms(v)) / 2
    bulk = _bulk(shear, v["poisson"])
    slope = np.full((3, 3), bulk)  # d tau_i / d ln(stretch_j)
    project = I3 - 1 / 3
    for mu, alpha in _ogden_terms(v):
        slope += mu * alpha * project @ np.diag(s**alpha) @ project
    tau = _ogden(stretch, v)
    W1 = tau / stretch
    W2 = (slope - np.diag(tau)) / np.outer(stretch, stretch)
    A = np.zeros((3, 3, 3, 3))
    for i in range(3):
        for j in range(3):
            A[i, i, j, j] = W2[i, j]
    for i in range(3):
        for j in range(3):
            if i == j:
                continue
            a, b = stretch[i], stretch[j]
            if abs(a - b) < 1e-5:
                mean, turned = (W2[i, i] + W2[j, j] - 2 * W2[i, j]) / 4, (W1[i] + W1[j]) / (a + b) / 2
                A[i, j, i, j], A[i, j, j, i] = mean + turned, mean - turned
            else:
                A[i, j, i, j] = (a * W1[i] - b * W1[j]) / (a**2 - b**2)
                A[i, j, j, i] = (b * W1[i] - a * W1[j]) / (a**2 - b**2)
    return A


@pytest.mark.parametrize("gap", [0.0, 1e-14, 1e-12, 1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize(
    "stretch", [(1.0, 1.0, 1.0), (1.5, 0.8, 0.8), (0.6, 1.3, 1.3), (1.2, 1.2, 1.2), (3.0, 0.5, 0.5), (1.3, 1.0, 0.7)]
)
def test_ogden_tangent_where_principal_stretches_meet(stretch: tuple[float, float, float], gap: float) -> None:
    """At any gap, and in axes that are not the mesh's, so that no component is zero by luck."""
    stretches = np.array(stretch) + gap * np.array((0.0, 1.0, -0.3))
    Q = rotation(np.random.default_rng(2))
    expected = np.einsum("ai,bj,ck,dl,ijkl->abcd", Q, Q, Q, Q, _ogden_elasticity(stretches, CASES["ogden"].values))
    tangent = body("ogden").elasticity(Q @ np.diag(stretches) @ Q.T)
    np.testing.assert_allclose(tangent, expected, atol=1e-9 * np.abs(expected).max())


def test_ogden_contains_neo_hooke_and_mooney_rivlin() -> None:
    values = {"mu1": 2 * 2e3, "alpha1": 2.0, "mu2": -2 * 5e2, "alpha2": -2.0, "poisson": 0.4}
    for F in deformations(5):
        energy, stress, _ = point("ogden")(F, values)
        other, other_stress, _ = point("mooney_rivlin")(F)
        assert energy == pytest.approx(other, rel=1e-9)
        np.testing.assert_allclose(stress, other_stress, atol=1e-9 * shear_of("mooney_rivlin"))


def test_gent_locks_at_its_limit() -> None:
    jm = CASES["gent"].values["jm"]
    limit = next(s for s in np.linspace(1, 4, 30001) if s**2 + 2 / s - 3 >= jm)
    below, above = (
        (limit + d) * np.array((1, 0, 0)) + (limit + d) ** -0.5 * np.array((0, 1, 1)) for d in (-1e-3, 1e-3)
    )
    assert point("gent")(np.diag(below))[1][0, 0] > 100 * shear_of("gent")
    assert math.isnan(point("gent")(np.diag(above))[0])


def test_fibres_carry_tension_only_and_engage_smoothly() -> None:
    name, values = "holzapfel_gasser_ogden", {**CASES["holzapfel_gasser_ogden"].values, "angle": 0.0, "kappa": 0.0}
    bare = {**values, "k1": 0.0}
    short = np.diag((0.8, 1.1, 1.1))
    assert point(name)(short, values)[0] == point(name)(short, bare)[0]
    b = body(name)
    b.set(values)
    stretches = np.sqrt(1 + np.array([-1e-9, 0.0, 1e-9, 0.01 - 1e-9, 0.01, 0.01 + 1e-9]))
    stiff = [b.elasticity(np.diag((s, 1.0, 1.0)))[0, 0, 0, 0] for s in stretches]
    b.set(CASES[name].values)
    assert np.ptp(stiff[:3]) < 1e-4 * values["k1"]
    assert np.ptp(stiff[3:]) < 1e-4 * values["k1"]
    assert stiff[4] - stiff[1] == pytest.approx(2 * 4 * values["k1"], rel=0.1)


# ---------------------------------------------------------------- parameters and their messages


@every_law
def test_good_values_pass_and_declarations_are_complete(name: str) -> None:
    law = materials.law(name)
    assert law.check(CASES[name].values) == []
    assert law.name == name
    assert law.title
    assert law.about
    for p in law.parameters:
        assert p.about
        parse_unit(p.unit)


@every_law
def test_bad_values_are_named_one_by_one(name: str) -> None:
    law, good = materials.law(name), CASES[name].values
    for p in law.parameters:
        missing = law.check({key: value for key, value in good.items() if key != p.name})
        assert (missing == []) if p.default is not None else (f"parameter '{p.name}' is missing" in missing[0])
        for wrong in (math.nan, math.inf, True, "12"):
            assert any(p.name in text for text in law.check({**good, p.name: wrong})), (p.name, wrong)
    assert "unknown parameter 'poison'" in law.check({**good, "poison": 0.3})[0]
    assert "did you mean 'poisson'?" in law.check({**good, "poison": 0.3})[0]
    several = law.check({**good, "poisson": -2.0, "colour": 1.0})
    assert len(several) == 2
    assert all(text.startswith(f"{name}: ") for text in several)


@every_law
def test_incompressible_needs_the_mixed_form(name: str) -> None:
    problems = materials.law(name).check({**CASES[name].values, "poisson": 0.5})
    assert len(problems) == 1
    assert "0.5" in problems[0]
    if materials.law(name).bulk is not None:
        assert "needs the mixed formulation" in problems[0]


def test_mixed_form_needs_a_positive_bulk_term() -> None:
    assert "use a greater poisson" in materials.law("neo_hooke").check({"young": 1e3, "poisson": 0.0}, mixed=True)[0]
    assert "use a greater poisson" in materials.law("neo_hooke").check({"young": 1e3, "poisson": -0.2}, mixed=True)[0]
    assert materials.law("neo_hooke").check({"young": 1e3, "poisson": 0.0}) == []
    assert materials.law("yeoh").check({"c1": 1e3, "poisson": 0.0}, mixed=True) == []
    svk = materials.law("saint_venant_kirchhoff").check({"young": 1e3, "poisson": 0.3}, mixed=True)
    assert "no separate volumetric energy" in svk[0]


def test_negative_initial_shear_modulus_is_refused() -> None:
    found = materials.law("mooney_rivlin").check({"c10": 100.0, "c01": -300.0, "poisson": 0.4})
    assert found == ["mooney_rivlin: the initial shear modulus is -400 Pa; it must be greater than 0 Pa"]
    assert "shear modulus" in materials.law("ogden").check({"mu1": 1e3, "alpha1": -2.0, "poisson": 0.4})[0]
    assert (
        "alpha2 = 0 is not an exponent"
        in materials.law("ogden").check({"mu1": 1e3, "alpha1": 2.0, "alpha2": 0.0, "poisson": 0.4})[0]
    )


def test_parameter_messages() -> None:
    young = materials.law("neo_hooke").parameters[0]
    assert young.check(15e3) is None
    assert young.check(-3.0) == "young = -3 Pa is outside the allowed range: greater than 0 Pa"
    assert young.check(0) == "young = 0 Pa is outside the allowed range: greater than 0 Pa"
    assert young.check(math.nan) == "young = nan is not a finite number; allowed: greater than 0 Pa"
    assert young.check(True) == "young = True is not a number; allowed: greater than 0 Pa"
    poisson = materials.law("neo_hooke").parameters[1]
    assert poisson.check(0.6) == "poisson = 0.6 is outside the allowed range: greater than -1 and at most 0.5"
    assert (
        poisson.check(0.5000000000000001)
        == "poisson = 0.5000000000000001 is outside the allowed range: greater than -1 and at most 0.5"
    )
    upper = Parameter("x", "1", "below one", upper=1, open_upper=True)
    assert upper.check(1) == "x = 1 is outside the allowed range: less than 1"
    assert upper.check(1 - 1e-15) is None
    assert Parameter("c01", "Pa", "constant").allowed == "any finite number"
    assert poisson.check(np.float64(0.3)) is None
    assert poisson.check(0) is None


def test_parameter_declarations_are_checked() -> None:
    with pytest.raises(ValueError, match="lower bound"):
        Parameter("x", "1", "reversed", lower=1, upper=0)
    with pytest.raises(ValueError, match="default or neutral value: x = 2 is outside"):
        Parameter("x", "1", "outside", default=2, upper=1)
    with pytest.raises(ValueError, match="both bulk and compliance"):
        replace(neo_hooke.law, compliance=None)


# ---------------------------------------------------------------- finding laws


def test_unknown_law_names_the_nearest_and_the_known() -> None:
    with pytest.raises(InputError, match=r"unknown material law 'neo-hook'.*did you mean 'neo_hooke'.*yeoh"):
        materials.law("neo-hook")
    for hidden in ("law", "_moduli"):
        assert hidden not in materials.names()


def test_a_file_dropped_in_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = "from dataclasses import replace\nfrom bcid.forms.materials.yeoh import law as yeoh\n"
    (tmp_path / "my_gel.py").write_text(source + "law = replace(yeoh, name='my_gel')\n")
    (tmp_path / "empty_gel.py").write_text("")
    monkeypatch.setattr(materials, "__path__", [*materials.__path__, str(tmp_path)])
    assert "my_gel" in materials.names()
    assert materials.law("my_gel").name == "my_gel"
    with pytest.raises(InputError, match="'empty_gel' must define law = Law"):
        materials.law("empty_gel")


def test_listing_the_laws_is_light() -> None:
    light = "import sys; from bcid.forms import materials; materials.names(); print('ufl' in sys.modules)"
    used = "print('dolfinx' in sys.modules); materials.law('ogden'); print('dolfinx' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", f"{light}; {used}"], capture_output=True, text=True, check=True).stdout
    assert out.split() == ["False", "False", "False"]


@every_law
def test_the_example_of_the_docstring_is_true(name: str) -> None:
    module = importlib.import_module(f"bcid.forms.materials.{name}")
    result = doctest.testmod(module)
    assert result.attempted > 0
    assert result.failed == 0
    for heading in ("Parameters:", "Equation:", "Relation to known quantities:", "Source:", "Example:"):
        assert module.__doc__ is not None
        assert heading in module.__doc__
