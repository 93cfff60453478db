"""Sensitivities by the tangent rule against differences of whole trajectories, for every kind of effect.

On the box of the effects' contract: pulled, turned, loaded, there and back, with steps that are not equally long. Fiducials,
and force and torque of the gripper.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from bcid.forms import effect_trial as trial
from bcid.forms import effects
from bcid.forms.forward import Forward
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import Model, Term
from bcid.forms.probes import Probe, Sensitivities, SensitivityRequest
from bcid.forms.responses import Responses
from bcid.forms.sensitivity import Sensitivity
from bcid.forms.solver.equilibrium import Settings
from bcid.predict.predictor import mechanical
from bcid.scene import Level, Material

Array = NDArray[np.float64]
SCENE, MESH, ACTIONS = trial.scene(), trial.box(), trial.actions()
ANCHORS = frozenset({"left"})
PLAIN = Model.of(SCENE)
STEP = 1e-3
FORCES = ForceScale(400.0, 0.05)


def term(name: str, place: str = "", **values: float) -> Term:
    return Term(effects.effect(name), values, place=place)


HEAVY = term("gravity", weight=9000.0)
FIBRES = term("fibres", k1=3000.0, angle=25.0)
TURNED = term("camera_offset", rx=3.0, ry=-2.0, rz=5.0, tx=1e-3, ty=0.0, tz=0.0, scale=1.02)
GIVING = term("grasp_compliance", stiffness=3e5)
PARTLY = term("partial_anchor", "left", stiffness=2e5, angle=20.0, border=0.2)
STILL = term("camera_offset", rx=0.0, ry=0.0, rz=0.0, tx=0.0, ty=0.0, tz=0.0, scale=1.0)


def positions(model: Model) -> Array:
    """A whole trajectory, solved to round-off."""
    forward = Forward(SCENE, 0, MPI.COMM_SELF, model, Settings(rtol=1e-12), MESH, FORCES)
    prediction = forward.predict(ANCHORS, ACTIONS)
    assert prediction.complete
    forward.destroy()
    return prediction.positions


def sensitivities(
    model: Model, wanted: SensitivityRequest, scene: object = SCENE, mesh: object = MESH
) -> Sensitivities:
    """By the tangent, as a predictor asks for them."""
    forward = Forward(scene, 0, MPI.COMM_SELF, mechanical(model), Settings(rtol=1e-12), mesh, FORCES)  # type: ignore[arg-type]
    prediction = forward.predict(ANCHORS, ACTIONS, keep=True)
    found = Sensitivity(forward).of(ANCHORS, ACTIONS, prediction, wanted, model)
    forward.destroy()
    return found


def differences(at: Callable[[float], Array], value: float, size: float, lower: float) -> Array:
    """Derivative of second order: central, or to one side at a bound."""
    step = STEP * size
    if value - step >= lower:
        return np.asarray((at(value + step) - at(value - step)) / (2 * step))
    return np.asarray((4 * at(value + step) - 3 * at(value) - at(value + 2 * step)) / (2 * step))


def assert_same(found: Array, expected: Array, tolerance: float = 1e-3) -> None:
    """Of the fiducials, and of force and torque where they change."""
    assert np.abs(expected).max() > 0
    count = len(SCENE.fiducials)
    for rows in (slice(count), slice(count, count + 1), slice(count + 1, None)):
        most = max(np.abs(expected[:, rows]).max(), 1e-6 * np.abs(expected).max())
        assert found[:, rows] == pytest.approx(expected[:, rows], abs=tolerance * most)


# What acts already, the effect that is asked for, and its number.
ADOPTED = [
    ((), HEAVY, "weight"),
    ((HEAVY,), FIBRES, "k1"),
    ((HEAVY,), FIBRES, "angle"),
    ((), term("compressibility", poisson=0.42), "poisson"),
    ((HEAVY,), term("soft_anchor", stiffness=2e6), "stiffness"),
    ((), term("grasp_slip", lag=0.15), "lag"),
    ((HEAVY,), TURNED, "ry"),
    ((HEAVY,), TURNED, "scale"),
    ((HEAVY,), term("prestrain", sx=1.02, sy=0.99, sz=1.01), "sy"),
    ((), term("stiffness_gradient", gx=0.3, gy=0.0, gz=-0.2), "gx"),
    ((TURNED,), HEAVY, "weight"),
    ((HEAVY,), GIVING, "stiffness"),
    ((GIVING,), HEAVY, "weight"),
    ((GIVING,), term("grasp_slip", lag=0.15), "lag"),
    ((GIVING,), term("soft_anchor", stiffness=2e6), "stiffness"),
    ((HEAVY,), PARTLY, "stiffness"),
    ((HEAVY,), PARTLY, "angle"),
    ((HEAVY,), PARTLY, "border"),
]


@pytest.mark.parametrize(("others", "asked", "name"), ADOPTED, ids=lambda p: getattr(p, "label", p if p else "-"))
def test_an_effect_that_acts(others: tuple[Term, ...], asked: Term, name: str) -> None:
    model = PLAIN
    for part in (*others, asked):
        model = model + part
    parameter = next(p for p in asked.effect.parameters if p.name == name)
    full = asked.full(name)

    def at(number: float) -> Array:
        return positions(model.with_values({full: 1 / number if parameter.reciprocal else number}))

    value = 1 / asked.values[name] if parameter.reciprocal else asked.values[name]
    size = abs(value) if parameter.reciprocal else parameter.scale
    expected = differences(at, value, size, -math.inf if parameter.reciprocal else parameter.lower)
    found = sensitivities(model, SensitivityRequest((Probe(asked, (name,)),))).probes[0][name]
    assert_same(found, expected)


DORMANT = [
    ((), term("gravity", weight=0.0), "weight"),
    ((HEAVY,), term("fibres", k1=0.0, angle=25.0), "k1"),
    ((HEAVY,), term("compressibility", poisson=0.35), "poisson"),
    ((HEAVY,), term("grasp_slip", lag=0.0), "lag"),
    ((), term("time_lag", seconds=0.0), "seconds"),
    ((HEAVY,), STILL, "rz"),
    ((HEAVY,), STILL, "scale"),
    ((HEAVY,), term("viscosity", fraction=0.0, relaxation_time=3.0), "fraction"),
    ((HEAVY,), term("support_friction", shear_stress=0.0), "shear_stress"),
    ((HEAVY, TURNED), term("marker_fault", "b", x=0.0, y=0.0, z=0.0, onset=2.0), "z"),
    ((), term("active_stress", amplitude=0.0, angle=40.0), "amplitude"),
    ((HEAVY,), term("strain_stiffening", c2=0.0), "c2"),
    ((GIVING,), term("grasp_slip", lag=0.0), "lag"),
    ((HEAVY,), term("softening", softened=0.0, strain=0.1), "softened"),
]


@pytest.mark.parametrize(("others", "asked", "name"), DORMANT, ids=lambda p: getattr(p, "label", p if p else "-"))
def test_a_dormant_effect(others: tuple[Term, ...], asked: Term, name: str) -> None:
    model = PLAIN
    for part in others:
        model = model + part
    parameter = next(p for p in asked.effect.parameters if p.name == name)

    def at(number: float) -> Array:
        return positions(model + asked.with_values({name: number}))

    expected = differences(at, asked.values[name], parameter.scale, parameter.lower)
    found = sensitivities(model, SensitivityRequest((Probe(asked, (name,)),))).probes[0][name]
    assert_same(found, expected)


HOLDS = [
    term("soft_anchor", stiffness=math.inf),
    term("soft_anchor", "left", stiffness=math.inf),
    term("grasp_compliance", stiffness=math.inf),
    PARTLY.with_values({"stiffness": math.inf}),
]


@pytest.mark.parametrize("asked", HOLDS, ids=lambda term: term.label)
def test_a_rigid_hold_that_may_yield(asked: Term) -> None:
    """Per unit of compliance: what springs of a great stiffness give way, times that stiffness."""
    rigid = PLAIN + HEAVY
    unmoved = positions(rigid)

    def yielding(stiffness: float) -> Array:
        return stiffness * (positions(rigid + asked.with_values({"stiffness": stiffness})) - unmoved)

    expected = 2 * yielding(1e9) - yielding(5e8)
    found = sensitivities(rigid, SensitivityRequest((Probe(asked, ("stiffness",)),))).probes[0]["stiffness"]
    assert_same(found, expected)


@pytest.mark.parametrize("formulation", ["displacement", "mixed"])
@pytest.mark.parametrize("others", [(HEAVY,), (GIVING,)], ids=["rigid", "springs"])
def test_products_tell_what_solves_tell(
    formulation: str, others: tuple[Term, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of forces, of a gripper that moves elsewhere, and of holds that yield; and once they are known without the tangent."""
    material = replace(SCENE.material, formulation=formulation)
    scene = replace(SCENE, material=material, levels=(Level(2 if formulation == "mixed" else 1),))
    model = Model.of(scene)
    for part in others:
        model = model + part
    asked = [Probe(term("gravity", weight=9000.0), ("weight",)), Probe(term("grasp_slip", lag=0.0), ("lag",))]
    asked += [Probe(term("soft_anchor", "left", stiffness=math.inf), ("stiffness",))]
    asked += [Probe(term("grasp_compliance", stiffness=math.inf), ("stiffness",))] if others == (HEAVY,) else []
    forward = Forward(scene, 0, MPI.COMM_SELF, model, Settings(rtol=1e-12), MESH, FORCES)
    prediction = forward.predict(ANCHORS, ACTIONS, keep=True)
    told = Sensitivity(forward)
    monkeypatch.setattr(Responses, "_serve", lambda *_: False)
    expected = told.of(ANCHORS, ACTIONS, prediction, SensitivityRequest(tuple(asked))).probes
    monkeypatch.setattr(Responses, "_serve", lambda *_: True)
    told.of(ANCHORS, ACTIONS, prediction, SensitivityRequest(tuple(asked)))
    monkeypatch.setattr(forward.equilibrium.tangent, "assemble", None)
    found = told.of(ANCHORS, ACTIONS, prediction, SensitivityRequest(tuple(asked))).probes
    for probe, one, other in zip(asked, found, expected, strict=True):
        assert_same(one[probe.wanted[0]], other[probe.wanted[0]], 1e-8)
    forward.destroy()


def test_a_constant_of_the_law_under_known_loads() -> None:
    model = PLAIN + HEAVY
    expected = differences(lambda young: positions(model.with_values({"young": young})), 15e3, 15e3, 0.0)
    assert_same(sensitivities(model, SensitivityRequest(law=("young",))).law["young"], expected)


def test_the_stiffness_of_all_cells_is_that_of_the_body() -> None:
    model = PLAIN + HEAVY
    found = sensitivities(model, SensitivityRequest(law=("young",), stiffness=True))
    assert found.stiffness is not None
    assert_same(found.stiffness.sum(axis=-1), 15e3 * found.law["young"])


def test_a_body_force_everywhere_is_gravity() -> None:
    space = fem.functionspace(Forward(SCENE, 0, MPI.COMM_SELF, PLAIN, mesh=MESH).body.domain, ("Lagrange", 1))
    volume = fem.assemble_vector(fem.form(ufl.TestFunction(space) * ufl.dx)).array
    found = sensitivities(
        PLAIN, SensitivityRequest((Probe(term("gravity", weight=0.0), ("weight",)),), forces=volume[:, None])
    )
    assert found.forces is not None
    along = found.forces[:, :, :, 0] @ np.array(SCENE.down)
    assert_same(along, found.probes[0]["weight"])


@pytest.mark.parametrize("formulation", ["displacement", "mixed"])
def test_what_grows_everywhere_swells(formulation: str) -> None:
    material = Material("neo_hooke", {"young": "15 kPa", "poisson": 0.4}, formulation)
    scene = replace(SCENE, material=material, levels=(Level(2),) if formulation == "mixed" else SCENE.levels)
    swelling = Probe(term("swelling", rate=0.0), ("rate",))
    found = sensitivities(
        Model.of(scene), SensitivityRequest((swelling,), growths=np.ones((len(MESH.cells), 1))), scene
    )
    assert found.growths is not None
    time = np.concatenate([action.clock for action in ACTIONS])
    assert_same(time[:, None, None] * found.growths[..., 0], found.probes[0]["rate"])


def test_with_a_pressure_as_unknown() -> None:
    """The mixed formulation: its tangent is a saddle point."""
    material = Material("neo_hooke", {"young": "15 kPa", "poisson": 0.499}, "mixed")
    scene = replace(SCENE, material=material, levels=(Level(2),))
    model = Model.of(scene)
    wanted = SensitivityRequest((Probe(term("gravity", weight=0.0), ("weight",)),), {"young": 1.5})
    found = sensitivities(model, wanted, scene)

    def at(one: Model) -> Array:
        return (
            Forward(scene, 0, MPI.COMM_SELF, one, Settings(rtol=1e-12), MESH, FORCES)
            .predict(ANCHORS, ACTIONS)
            .positions
        )

    heavier = differences(lambda w: at(model + term("gravity", weight=w)), 0.0, 5000.0, 0.0)
    assert_same(found.probes[0]["weight"], heavier)
    stiffer = differences(lambda young: at(model.with_values({"young": young})), 15e3, 15e3, 0.0)
    assert_same(found.law["young"], stiffer)


def test_an_inclusion_far_outside_of_the_body_moves_nothing() -> None:
    """Its edge is sharp beside the distance, and its slope there underflows."""
    ball = {"ratio": 3.0, "cx": 0.5, "cy": 0.2, "cz": 0.0, "radius": 1e-3}
    added = Term(effects.effect("inclusion"), ball)
    found = sensitivities(PLAIN + added, SensitivityRequest((Probe(added, tuple(ball)),)))
    for name, moved in found.probes[0].items():
        assert np.abs(moved).max() < 1e-12, name
