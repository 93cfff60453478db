"""Published plates in plane strain: rollers, edges that slide in their grip, two coordinates, two reactions, another U(J)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.forms.model import Model, check_physics
from bcid.predict.predictor import Predictor
from bcid.scene import Material
from bcid.search.answer.adequacy import judge
from bcid.search.fitting.fit import Fit, fit
from bcid.search.fitting.state import State

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SCENE = EXAMPLES / "scenes" / "plate.toml"
FREE = ("c10", "c01", "poisson")


def constants(bulk: float, c10: float, c01: float) -> dict[str, float]:
    """Those of Mooney and Rivlin's law, from kPa; U = bulk/2 (J - 1)^2."""
    shear = 2 * (c10 + c01)
    return {"c10": 1e3 * c10, "c01": 1e3 * c01, "poisson": (3 * bulk - 2 * shear) / (2 * (3 * bulk + shear))}


TRUE = {
    "neo-hooke": constants(40, 10, 0),
    "mooney-rivlin": constants(40, 10, 40),
    "blatz-ko": constants(10, 0, 50),
}


def fitted(scene: Scene, name: str) -> Fit:
    """All constants of the law, with the default uncertainties of everything else."""
    predictor = Predictor(scene, Measurement.read(EXAMPLES / "measurements" / f"plate-{name}"), MPI.COMM_SELF)
    found = fit(State.of(predictor, Model.of(scene), frozenset()), FREE)
    found = fit(found.state.with_own_errors(anew=True), FREE, like=found)
    predictor.destroy()
    return found


def shear(values: Mapping[str, float]) -> float:
    return 2 * (values["c10"] + values["c01"])


@pytest.mark.parametrize("name", list(TRUE))
def test_constants_are_those_that_the_plate_was_made_with(name: str) -> None:
    scene = Scene.read(SCENE, physics=check_physics)
    measured = Measurement.read(EXAMPLES / "measurements" / f"plate-{name}")
    assert np.isnan(measured.positions[..., 2]).all()
    assert np.isfinite(measured.wrenches).all(axis=0).tolist() == [True, True, False, False, False, False]
    found = fitted(scene, name)
    assert judge(found.state).adequate
    for number, true in TRUE[name].items():
        assert abs(found.values[number] - true) < 2 * found.stderr[number], number
    # c10 and c01 stand for each other; their sum and Poisson's ratio are known.
    assert shear(found.values) == pytest.approx(shear(TRUE[name]), rel=0.02)
    assert found.stderr["poisson"] < 0.02


def test_another_volumetric_energy_explains_no_plate() -> None:
    scene = Scene.read(SCENE, physics=check_physics)
    assert (scene.material.volumetric, Model.of(scene).volumetric) == ("quadratic", "quadratic")
    other = replace(scene, material=replace(scene.material, volumetric=""))
    assert other.fingerprint() != scene.fingerprint()
    assert not judge(fitted(other, "mooney-rivlin").state).adequate


def test_a_form_that_a_law_does_not_have_is_refused() -> None:
    scene = Scene.read(SCENE)

    def said(material: Material) -> list[str]:
        return check_physics(replace(scene, material=material))

    own = scene.material
    assert said(own) == []
    (problem,) = said(replace(own, volumetric="quadratik"))
    assert problem.startswith("material.volumetric: 'quadratik': did you mean 'quadratic'?")
    assert any(
        "known: log, quadratic" in text for text in said(replace(own, volumetric="simo_taylor", formulation="mixed"))
    )
    svk = Material("saint_venant_kirchhoff", {"young": "20 kPa", "poisson": 0.3}, volumetric="log")
    assert said(svk) == ["material.volumetric: saint_venant_kirchhoff: has no separate volumetric energy"]
