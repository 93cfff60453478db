"""Formulas of effects of material and boundary, against numbers worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from contract.test_effects import BAR, EXACT, MU, bar, model, move, rollers, scene_of
from numpy.typing import NDArray
from verify.problems import Prescribed, box

from bcid.forms import effects
from bcid.forms.forward import Forward
from bcid.forms.model import Held, Term
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose
from bcid.scene import Level

Array = NDArray[np.float64]


def cube(term: Term) -> Prescribed:
    """A cube of edge 1 m, held all around; `set_gradient` says how it is deformed."""
    return Prescribed.on(box((1.0, 1.0, 1.0), (1, 1, 1)), model() + term + Held("all"), rtol=1e-12)


def energy(equilibrium: Prescribed, gradient: Array, time: float = 0.0) -> float:
    """Of a homogeneous deformation (J), which is then the last one."""
    equilibrium.field = lambda points: points @ (gradient - np.eye(3)).T  # type: ignore[method-assign]
    pose = Pose(time=time)
    assert equilibrium.solve(pose) is Status.CONVERGED
    found = equilibrium.energy()
    equilibrium.accept(pose)
    return found


def deviator(gradient: Array) -> Array:
    strain = (gradient.T @ gradient - np.eye(3)) / 2
    return np.asarray(strain - np.trace(strain) / 3 * np.eye(3))


STATES = [np.diag([1 + x, 1 - x / 2, 1.0]) + 0.3 * x * np.eye(3, k=1) for x in (0.02, 0.2, 0.1, -0.1, 0.0)]


def test_a_swelling_block_grows_without_stress() -> None:
    parts = rollers(model() + Term("swelling", {"rate": 2e-3}))
    equilibrium = bar(parts)
    for time in (0.0, 50.0):
        assert equilibrium.solve(Pose(time=time)) is Status.CONVERGED
        expected = equilibrium.body.nodes * math.expm1(2e-3 * time)
        np.testing.assert_allclose(equilibrium.displacement(), expected, atol=1e-9)
        assert equilibrium.energy() == pytest.approx(0.0, abs=1e-12)


def test_a_permanent_set_follows_what_is_beyond_the_yield_strain() -> None:
    """Against a return mapping by hand, there and back; none of these steps ends where the stress bends."""
    kept, limit = 0.4, 0.05
    with_it, without = (
        cube(Term("permanent_set", {"kept": kept, "yield_strain": limit})),
        cube(Term("gravity", {"weight": 0.0})),
    )
    remains = np.zeros((3, 3))
    yields = []
    for state in STATES:
        left = deviator(state) - remains
        size = float(np.linalg.norm(left))
        assert abs(size / limit - 1) > 0.05
        expected = size**2 if size < limit else 2 * limit * size - limit**2
        more = energy(with_it, state) - energy(without, state)
        # Where it has begun to yield the bend adds a constant: a twelfth of the square of its width.
        assert more == pytest.approx(MU * kept / (1 - kept) * expected, rel=2e-3)
        remains = remains + max(1 - limit / size, 0.0) * left
        yields.append(size > limit)
    assert yields == [False, True, True, True, True]


def test_a_softened_body_goes_back_along_another_way() -> None:
    """A cube in a cycle of stretch: the force against the pseudo-elastic factor of Ogden & Roxburgh, worked out by hand."""
    softened, strain = 0.4, 0.15
    equilibrium = cube(Term("softening", {"softened": softened, "strain": strain}))
    end = equilibrium.body.nodes[:, 0] > 1 - 1e-9
    largest, factors = 0.0, []
    for stretch in (1.0, 1.3, 1.2, 1.05, 1.25, 1.4, 1.3):
        energy(equilibrium, np.diag([stretch, stretch**-0.5, stretch**-0.5]))
        invariant = stretch**2 + 2 / stretch
        factors.append(1 - softened * math.erf(max(largest - (invariant - 3), 0.0) / (3 * strain**2)))
        spared = (factors[-1] - 1) * MU * (stretch - invariant / 3 / stretch)
        pull = float(equilibrium.forces().reshape(-1, 3)[end, 0].sum())
        assert pull == pytest.approx(MU * (stretch - 1 / stretch) + spared, rel=1e-9, abs=1e-9 * MU)
        largest = max(largest, invariant - 3)
    assert np.sign(1 - np.array(factors)).tolist() == [0, 0, 1, 1, 1, 0, 1]
    # Another action is that of another body.
    equilibrium.reset()
    assert equilibrium.weak_form.memories["softening"].variables["largest"].x.array.max() == 0


def test_a_body_that_is_only_pulled_is_not_softened() -> None:
    """However suddenly it would be on its way back: the check of its stability, after each step, looks at the turning point."""
    scene = replace(scene_of(("x0",), "x1", (0.1, 0.01, 0.01), fiducials={"a": (0.05, 0.01, 0.02)}), levels=(Level(2),))
    pull = [move(np.linspace(0, 1, 9)[:, None] * np.array([0.02, 0.005, 0.0]), "x1")]
    found = []
    for term in (Term("softening", {"softened": 0.8, "strain": 0.01}), Term("gravity", {"weight": 0.0})):
        forward = Forward(scene, model=model() + term, settings=EXACT, mesh=box(BAR, (5, 1, 1)))
        prediction = forward.predict(["x0"], pull)
        assert prediction.complete
        assert not prediction.trajectories[0].halvings
        found.append(prediction.positions)
        for memory in forward.equilibrium.weak_form.memories.values():
            # By round-off a point is on its way back already, or not.
            largest = memory.variables["largest"].x.array.reshape(len(forward.mesh.cells), -1)
            largest += 1e-12 * np.where(np.arange(largest.shape[1]) == 0, 1, -1)
            forward.set_model(forward.model)
            assert forward.equilibrium.verify() is Status.CONVERGED
        forward.destroy()
    np.testing.assert_allclose(*found, atol=1e-9)


def test_a_large_ball_is_a_plane_that_pushes_back() -> None:
    """A cube that is moved up into it by 3 mm."""
    radius, before, edge = 1e5, 1e-3, 1e-3 * math.sqrt(3)
    values = {"stiffness": 1e5, "cx": 0.5, "cy": 1 + before + radius, "cz": 0.5, "radius": radius}
    equilibrium = cube(Term("obstacle", values))
    found = []
    for up in (0.5e-3, 4e-3):
        equilibrium.field = lambda points, up=up: np.tile([0.0, up, 0.0], (len(points), 1))  # type: ignore[method-assign]
        assert equilibrium.solve(Pose()) is Status.CONVERGED
        found.append(equilibrium.energy())
    assert found[0] == pytest.approx(0.0, abs=1e-12)
    # At the corners the ball is higher by 2.5 um.
    gap = 4e-3 - before
    assert found[1] == pytest.approx(1e5 * ((gap - edge / 2) ** 2 / 2 + edge**2 / 24), rel=1e-3)


def test_a_layer_is_a_membrane_on_every_face() -> None:
    """Of its two stretches in each face, and the third that keeps its volume."""
    gradient = np.eye(3) + np.array([[0.1, 0.05, -0.02], [0.0, -0.05, 0.08], [0.1, 0.03, 0.05]])
    tension, expected = 40.0, 0.0
    for axis in range(3):
        inside = np.delete(gradient, axis, axis=1)
        square = inside.T @ inside
        expected += 2 * tension / 2 * (np.trace(square) + 1 / np.linalg.det(square) - 3)
    with_it, without = (cube(Term(*t)) for t in (("layer", {"stiffness": tension}), ("gravity", {"weight": 0.0})))
    assert energy(with_it, gradient) - energy(without, gradient) == pytest.approx(expected, rel=1e-8)


def test_a_tether_holds_along_its_direction_alone() -> None:
    values = {"stiffness": 3e4, "angle": 30.0}
    equilibrium = Prescribed.on(
        box((1.0, 1.0, 1.0), (1, 1, 1)), model() + Term("tether", values, place="all") + Held("all")
    )
    up, along, aside = 1e-3, math.cos(math.radians(30)), math.sin(math.radians(30))
    moves = {along: [up, 0.0, 0.0], aside: [0.0, 0.0, up], 0.0: [0.0, up, 0.0]}
    for part, way in moves.items():
        equilibrium.field = lambda points, way=way: np.tile(way, (len(points), 1))  # type: ignore[method-assign]
        assert equilibrium.solve(Pose()) is Status.CONVERGED
        assert equilibrium.energy() == pytest.approx(6 * 1.5e4 * (part * up) ** 2, abs=1e-12)


def test_what_a_scene_that_is_slightly_wrong_looks_like_is_looked_for_only_where_it_is_named() -> None:
    names = {effect.name for effect in effects.catalogue()}
    assert "gravity" in names
    assert "layer" not in names
    assert [effect.name for effect in effects.catalogue(["layer"])] == ["layer"]
