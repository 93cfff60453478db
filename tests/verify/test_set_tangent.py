"""What other sets show, told to first order about one that was followed, against predictions of their own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from bcid.forms import effects
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.set_tangent import SetTangent
from bcid.forms.simulate import simulate
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.mesh_error import MeshError
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.scene import Level, Scene
from bcid.search.fitting.loosened import loosened
from bcid.search.fitting.state import State

ABOUT = frozenset({"3", "4"})
STEPS = 3
# Fiducials, force, torque.
ROWS = slice(0, -2), slice(-2, -1), slice(-1, None)


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    return replace(scene, levels=(Level(2, 0.05),), noise_sigma=0.2e-3)


def pulls(reach: float) -> list[Action]:
    """Two pulls of so many m."""
    unturned, steps = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1)), np.arange(STEPS)
    ways = {"I": (1, 0, 0), "II": (0, 1, 0.5)}
    return [
        Action(str(k), k * STEPS + steps, steps, grasp, reach / (STEPS - 1) * steps[:, None] * np.array(way), unturned)
        for k, (grasp, way) in enumerate(ways.items())
    ]


@pytest.fixture(params=[1e-4, 1e-2], ids=["small", "large"])
def reach(request: pytest.FixtureRequest) -> float:
    return float(request.param)


@pytest.fixture
def predictor(slab: Scene, reach: float) -> Iterator[Predictor]:
    measurement = simulate(slab, ABOUT, pulls(reach), level=0, wrench=True)
    predictor = Predictor(slab, measurement, MPI.COMM_SELF, settings=Settings(rtol=1e-8))
    yield predictor
    predictor.destroy()


def relative(found: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2)))


def springs(stiffness: float) -> Term:
    return Term("soft_anchor", {"stiffness": stiffness})


def about(predictor: Predictor, model: Model) -> SetTangent:
    return predictor.set_tangent(model, ABOUT, predictor.predict(model, ABOUT, keep=True))


@pytest.mark.parametrize("soft", ["", "soft_anchor", "grasp_compliance"])
def test_a_set_moves_the_fiducials_as_its_tangent_says(predictor: Predictor, reach: float, soft: str) -> None:
    """Small pulls: up to what polynomial tractions leave out of a reaction; pulls of a tenth of the body: nearly."""
    model = Model.of(predictor.scene)
    if soft:
        model = model + Term(soft, {"stiffness": 1e6})
    tangent = about(predictor, model)
    here = predictor.predict(model, ABOUT).positions
    for other in ("4", "1 3 4", "2 3 4", "3", "1 4", "3 4 8"):
        anchors = frozenset(other.split())
        moved = predictor.predict(model, anchors).positions - here
        for rows in ROWS:
            miss = relative(tangent.moved(anchors)[:, rows], moved[:, rows])
            assert miss < (0.06 if reach < 1e-3 else 0.15 if rows.start == 0 else 0.3), (other, rows)


def test_a_set_that_gives_moves_the_fiducials_as_a_rigid_one_tells(predictor: Predictor, reach: float) -> None:
    """From a rigid set to springs, however soft, on another."""
    tangent, here = (
        about(predictor, Model.of(predictor.scene)),
        predictor.predict(Model.of(predictor.scene), ABOUT).positions,
    )
    for stiffness in (5e4, 5e5, 5e6):
        soft = Model.of(predictor.scene) + Term("soft_anchor", {"stiffness": stiffness})
        for anchors in (ABOUT, frozenset("134")):
            moved = predictor.predict(soft, anchors).positions - here
            told = tangent.moved(anchors, dict.fromkeys(anchors, springs(stiffness)))
            for rows in ROWS:
                miss = relative(told[:, rows], moved[:, rows])
                assert miss < (0.08 if reach < 1e-3 else 0.2 if rows.start == 0 else 0.3), (stiffness, anchors, rows)


def test_a_part_that_gives_moves_the_fiducials_as_a_rigid_patch_tells(slab: Scene, reach: float) -> None:
    """From a rigid set to one of which a half of a patch gives: in which direction, and about how far."""
    fine = replace(slab, levels=(Level(2, 0.02),))
    predictor = Predictor(fine, simulate(fine, ABOUT, pulls(reach), level=0), MPI.COMM_SELF)
    tangent, plain = about(predictor, Model.of(fine)), Model.of(fine)
    here = predictor.predict(plain, ABOUT).positions
    for patch, angle, border in (("3", 90.0, 0.0), ("3", 270.0, 0.0), ("4", 90.0, 0.5)):
        part = Term("partial_anchor", {"stiffness": 3e5, "angle": angle, "border": border}, place=patch)
        moved = predictor.predict(plain + part, ABOUT).positions - here
        told = tangent.moved(ABOUT, {patch: part})
        assert np.sum(told * moved) > 0.95 * np.sqrt(np.sum(told**2) * np.sum(moved**2)), (patch, angle)
        assert relative(told, moved) < 0.5, (patch, angle)
    predictor.destroy()


@pytest.mark.parametrize("stiffness", [5e4, 1e6, 1.5e7])
def test_soft_and_stiff_springs_are_found(slab: Scene, stiffness: float) -> None:
    """Of the stiffnesses that are looked at that fits best which is nearest to the truth, also where the springs are stiff."""
    giving = Model.of(slab) + Term("soft_anchor", {"stiffness": stiffness})
    predictor = Predictor(slab, simulate(slab, ABOUT, pulls(1e-2), level=0, noise=0.0, model=giving), MPI.COMM_SELF)
    state = State.of(predictor, Model.of(slab), ABOUT, MeshError.unknown(predictor.data.mask.shape))
    best = loosened(state, effects.effect("soft_anchor"), [ABOUT], ())[0]
    assert 0.5 < best.term.values["stiffness"] / stiffness < 2.0
    predictor.destroy()


def test_no_compliance_is_a_rigid_anchor(predictor: Predictor) -> None:
    tangent = about(predictor, Model.of(predictor.scene))
    stiff = tangent.moved(frozenset("134"), {"1": springs(1e30)})
    assert stiff == pytest.approx(tangent.moved(frozenset("134")), abs=1e-15)


def test_nothing_moves_with_the_set_that_was_followed(predictor: Predictor) -> None:
    assert not about(predictor, Model.of(predictor.scene)).moved(ABOUT).any()


@pytest.mark.parametrize("reach", [1e-2], indirect=True)
def test_many_sets_are_what_each_system_of_its_own_tells(predictor: Predictor) -> None:
    """In whatever order they are asked for, and whichever patches give."""
    tangent = about(predictor, Model.of(predictor.scene))
    cases = [("1 3 4", {}), ("3 4", {}), ("", {}), ("1 3 4", {"3": 1e-6}), ("1", {}), ("1 3", {"1": 1e-5}), ("1 3", {})]
    cases += [("1 2 3 4 5 6 7 8", {"8": 1e-6}), ("8", {"8": 1e-6}), ("1 3 4", {"3": 1e-5, "4": 1e-6})]
    terms = [{name: springs(1 / compliance) for name, compliance in soft.items()} for _, soft in cases]
    found = tangent.all_moved([frozenset(names.split()) for names, _ in cases], terms)

    def alone(names: str, soft: dict[str, float], frame: int) -> NDArray[np.float64]:
        step, own = tangent.steps[frame], [tangent.tractions[name] for name in sorted(names.split())]
        chosen = np.concatenate([np.zeros(0, np.int64), *own])
        yielding = np.zeros_like(step.compliance)
        for name, compliance in soft.items():
            inside = np.ix_(tangent.tractions[name], tangent.tractions[name])
            yielding[inside] = tangent.springs(name, springs(1 / compliance))
        matrix = (step.compliance + yielding)[np.ix_(chosen, chosen)]
        return step.freed - step.shown[:, chosen] @ np.linalg.solve(matrix, step.apart[chosen])

    for (names, soft), moved in zip(cases, found, strict=True):
        for frame in tangent.steps:
            expected = alone(names, soft, frame) - alone(" ".join(sorted(ABOUT)), {}, frame)
            assert moved[frame].ravel() == pytest.approx(expected, abs=1e-9)
