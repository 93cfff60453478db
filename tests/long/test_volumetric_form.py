"""Another form of the volumetric energy as something that may be missing: found, and not put down to the rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.base.options import ExplainOptions
from bcid.forms.model import check_physics
from bcid.forms.simulate import simulate
from bcid.predict.predictor import Predictor
from bcid.scene import Level
from bcid.search.answer.explanation import Explanation
from bcid.search.explain import explain

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FORMS = ("volumetric_quadratic", "volumetric_simo_taylor")
RIVALS = ("compressibility", "strain_stiffening")
PART = "volumetric_quadratic.part"


@pytest.fixture(scope="module")
def plate() -> Scene:
    """The published plate, whose law has U = K/2 (J - 1)^2; its volume grows by up to a half."""
    return Scene.read(EXAMPLES / "scenes" / "plate.toml", physics=check_physics)


@pytest.fixture(scope="module")
def published() -> Measurement:
    return Measurement.read(EXAMPLES / "measurements" / "plate-neo-hooke")


def explained(scene: Scene, measured: Measurement, only: tuple[str, ...]) -> Explanation:
    """With the law's own form of U, which is log."""
    own = replace(scene, material=replace(scene.material, volumetric=""))
    predictor = Predictor(own, measured, MPI.COMM_SELF)
    found = explain(predictor, ExplainOptions(only=only))
    predictor.destroy()
    return found


def test_explain_other_volumetric_form_is_found(plate: Scene, published: Measurement) -> None:
    """By cubic elements; without the candidate nothing that is known explains it."""
    constants = {"c10": "10 kPa", "c01": "0 kPa", "poisson": 0.286}
    scene = replace(plate, material=replace(plate.material, values=constants))
    true = replace(scene, levels=(Level(3, 0.012),))
    seen = simulate(true, (), published.actions, noise=0.02e-3, wrench=True, wrench_noise=0.02)
    seen.data["position"][{"axis": 2}] = np.nan
    found = explained(scene, seen, (*FORMS, *RIVALS))
    assert found.verdict == "volumetric_quadratic"
    assert found.last.fitted.values[PART] == pytest.approx(1.0, abs=0.05)
    assert explained(scene, seen, RIVALS).verdict == "unknown"


def test_explain_published_plate_names_form_and_poisson(plate: Scene, published: Measurement) -> None:
    """The scene has another Poisson's ratio than the plate was made with, 0.286, and another form of U."""
    found = explained(plate, published, (*FORMS, *RIVALS))
    assert set(found.verdict.split("+")) == {"volumetric_quadratic", "compressibility"}
    assert found.last.fitted.values["compressibility.poisson"] == pytest.approx(0.286, abs=0.01)
    assert found.last.fitted.values[PART] == pytest.approx(1.0, abs=0.06)


def test_explain_form_of_the_scene_is_not_replaced(plate: Scene, published: Measurement) -> None:
    predictor = Predictor(plate, published, MPI.COMM_SELF)
    found = explain(predictor, ExplainOptions(only=("volumetric_log", "volumetric_simo_taylor", "compressibility")))
    predictor.destroy()
    assert found.verdict == "compressibility"
