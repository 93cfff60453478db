"""Lengths from pictures share an unknown factor: what that changes, against bodies that are larger, and for a stiffness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray
from verify.problems import two_pulls

from bcid.forms import effect_trial as trial
from bcid.forms.forward import Forward
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.sensitivity import Sensitivity
from bcid.forms.simulate import recorded, simulate
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.data import Data
from bcid.inference.nuisances import Nuisances
from bcid.measurement import WRENCH, Action, Measurement
from bcid.predict.predictor import Predictor
from bcid.scene import Level, Scene
from bcid.scene.parts import Vector
from bcid.scene.uncertainty import Uncertainty
from bcid.search.fitting.fit import Fit
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
EXACT = Settings(rtol=1e-12)
ANCHORS = frozenset({"left"})
FORCES = ForceScale(500.0, 0.06)
SIGMA = 0.02


def plain(scene: Scene) -> Model:
    return Model.of(scene)


def heavy(scene: Scene) -> Model:
    """With a weight, an elastic support and a skin: units with a length in them to every power."""
    model = Model.of(scene) + Term("gravity", {"weight": 2e4}) + Term("foundation", {"stiffness": 4e4}, place="bottom")
    return model + Term("layer", {"stiffness": 20.0})


def pulled(loaded: bool) -> Action:
    whole = trial.actions()[0]
    return whole if loaded else replace(whole, loads={})


def in_pictures(part: float, action: Action, model: Callable[[Scene], Model], path_too: bool) -> Array:
    """What pictures and sensor show of a body whose lengths are larger by so much than the pictures say."""
    metre = 1 + part
    scene = trial.scene(trial.SimilarUnits(metre))
    # The material is the same, and so are all forces on it.
    scene = replace(scene, material=trial.scene().material)
    path = action.translation * metre if path_too else action.translation
    mesh = replace(trial.box(), points=trial.box().points * metre)
    forward = Forward(scene, 0, MPI.COMM_SELF, model(scene), EXACT, mesh, FORCES)
    prediction = forward.predict(ANCHORS, [replace(action, translation=path)])
    forward.destroy()
    assert prediction.complete
    shown = prediction.positions.copy()
    shown[:, :-2] /= metre
    return shown


@pytest.mark.parametrize("path_too", [False, True])
@pytest.mark.parametrize(("model", "loaded"), [(plain, False), (plain, True), (heavy, True)])
def test_a_longer_pixel_is_seen_and_felt_as_a_larger_body_is(
    model: Callable[[Scene], Model], loaded: bool, path_too: bool
) -> None:
    known = replace(Uncertainty.none(), scale=SIGMA, scale_of_gripper=path_too)
    action, here = pulled(loaded), replace(trial.scene(), uncertainty=known)
    forward = Forward(here, 0, MPI.COMM_SELF, model(here), EXACT, trial.box(), FORCES)
    prediction = forward.predict(ANCHORS, [action], keep=True)
    seen = recorded(here, [action], prediction.positions[:, :-2], 1e-4, np.random.default_rng(0))
    wrench = ("frame", "component"), FORCES.wrenches(prediction.positions[:, -2:])
    felt = replace(seen, data=seen.data.assign(wrench=wrench).assign_coords(component=WRENCH), wrench_sigma=1e-3)
    data = Data(here, felt, FORCES)
    nuisances = Nuisances(here, forward.mesh, forces=True)
    wanted = nuisances.wanted(model(here), ANCHORS)
    found = Sensitivity(forward).of(ANCHORS, [action], prediction, wanted)
    modes = nuisances.modes(data, found, wanted, model(here), prediction.positions)
    forward.destroy()
    step = 1e-3
    slope = (in_pictures(step, action, model, path_too) - in_pictures(-step, action, model, path_too)) / (2 * step)
    expected = data.vector(slope)
    assert modes.names == ("scale",)
    assert modes.sizes == {"scale": SIGMA}
    for kind in range(3):
        mine = data.kind == kind
        error = np.linalg.norm(modes.common[mine, 0] / SIGMA - expected[mine])
        # A gripper and a body that are known in the same lengths move alike, whatever these are.
        whole = np.linalg.norm(data.vector(prediction.positions - prediction.positions[0])[mine])
        assert error < 2e-4 * whole
    alike = path_too and not loaded
    assert (np.abs(expected[data.kind == 0]).max() < 1e-9) == alike
    assert np.abs(expected[data.kind > 0]).max() > 1e-5


# -- what it is worth
# ------------------------------------------------------------------------------------------------------------------

SHEET = frozenset("34")
# A pixel is so much longer than is said; Young's modulus of the scene, and of the body that was pulled, Pa.
LONGER, STATED, TRUE = 1.03, 15e3, 19e3


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    return Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)


def larger(scene: Scene, factor: float) -> Scene:
    """The same body, with all its places, with every length larger by a factor; of cubic elements."""

    def there(place: Vector) -> Vector:
        x, y, z = (factor * value for value in place)
        return x, y, z

    young = {**scene.material.values, "young": f"{TRUE} Pa"}
    bottom = scene.places["bottom"].plane
    assert bottom is not None
    assert not any(bottom.point)
    return replace(
        scene,
        length_unit=scene.length_unit * factor,
        levels=(Level(3, 0.016 * factor),),
        material=replace(scene.material, values=young),
        grasps={name: replace(grasp, centre=there(grasp.centre)) for name, grasp in scene.grasps.items()},
        fiducials={name: there(place) for name, place in scene.fiducials.items()},
    )


@pytest.fixture(scope="module", params=[False, True], ids=["path by a robot", "path by pictures"])
def filmed(slab: Scene, request: pytest.FixtureRequest) -> tuple[Measurement, bool]:
    """What a camera shows whose pixels are longer than is said; forces are not filmed."""
    true = simulate(larger(slab, LONGER), SHEET, two_pulls(), noise=0.1e-3, wrench=True, wrench_noise=0.01)
    data = true.data.copy(deep=True)
    data["position"] = data["position"] / LONGER
    if request.param:
        data["translation"] = data["translation"] / LONGER
    return replace(true, data=data), request.param


def interval(scene: Scene, seen: Measurement, uncertainty: Uncertainty) -> tuple[float, float]:
    """Of Young's modulus, with 95 %, Pa."""
    predictor = Predictor(replace(scene, uncertainty=uncertainty), seen, MPI.COMM_SELF)
    found = Fit.at(State.of(predictor, Model.of(predictor.scene), SHEET)).stiffness
    predictor.destroy()
    assert found is not None
    return found.interval(STATED)


def test_the_length_of_a_pixel_widens_the_interval_of_youngs_modulus(
    slab: Scene, filmed: tuple[Measurement, bool]
) -> None:
    """Three percent of a pixel are three of the force where the path is known in mm, and six where it is not."""
    seen, path_too = filmed
    sure = replace(Uncertainty.none(), stiffness=0.5, force_gain=0.002)
    low, high = interval(slab, seen, sure)
    assert not low < TRUE < high
    low, high = interval(slab, seen, replace(sure, scale=0.02, scale_of_gripper=path_too))
    assert low < TRUE < high
    assert high - low < 0.2 * TRUE
    # That of the measurement is taken before that of the scene, which says nothing here.
    stated = replace(seen, scale_sigma=0.02, scale_of_gripper=path_too)
    assert interval(slab, stated, sure) == pytest.approx((low, high))
