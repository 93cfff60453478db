"""Sensitivities to what acts by the clock, from those to what is steady."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid.forms import effects
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.probes import Probe, SensitivityRequest
from bcid.forms.sensitivity import Sensitivity
from bcid.forms.simulate import simulate
from bcid.predict.acting import by_the_clock, steady
from bcid.predict.predictor import Predictor
from bcid.scene import Scene
from bcid.scene.motions import motion
from bcid.search.fitting.variants import neutral_values

TIMES = np.array([0.0, 1.0, 3.0])


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    return Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)


def probe(slab: Scene, name: str, **values: float) -> Probe:
    effect = effects.effect(name)
    numbers = neutral_values(Model.of(slab), effect) | values
    return Probe(Term(effect, numbers), tuple(p.name for p in effect.amounts))


def test_what_grows_with_time_is_time_times_what_has_grown(slab: Scene) -> None:
    swelling = probe(slab, "swelling")
    always = steady(swelling, Model.of(slab), TIMES)
    assert always is not None
    assert always.wanted == ("rate",)
    assert always.effect.smooth
    found = by_the_clock(swelling, {"rate": np.ones((3, 2, 3))}, TIMES)
    assert np.allclose(found["rate"], TIMES[:, None, None] * np.ones((3, 2, 3)))


def test_what_comes_and_goes_is_the_part_of_it_that_acts(slab: Scene) -> None:
    contraction = probe(slab, "active_stress", period=4.0)
    assert steady(contraction, Model.of(slab), TIMES) is not None
    found = by_the_clock(contraction, {"amplitude": np.ones((3, 1, 3))}, TIMES)
    assert found["amplitude"][:, 0, 0] == pytest.approx([0.0, 0.5, 0.5])


@pytest.mark.parametrize(
    ("name", "values"), [("swelling", {"rate": 1e-3}), ("gravity", {}), ("camera_offset", {}), ("viscosity", {})]
)
def test_nothing_else_is_taken_for_steady(slab: Scene, name: str, values: dict[str, float]) -> None:
    assert steady(probe(slab, name, **values), Model.of(slab), TIMES) is None


def test_a_predictor_tells_what_every_step_does(slab: Scene) -> None:
    measurement = simulate(slab, {"1", "2"}, motion("semicircle", "II"), level=0, noise=1e-4, random_state=1)
    predictor, model, anchors = Predictor(slab, measurement, MPI.COMM_SELF, level=0), Model.of(slab), {"1", "2"}
    prediction = predictor.predict(model, anchors, keep=True)
    wanted = SensitivityRequest((probe(slab, "gravity"), probe(slab, "swelling"), probe(slab, "camera_offset")))
    found = predictor.sensitivities(model, anchors, prediction, wanted)
    forward = predictor.forward(model)
    (part,) = prediction.parts.values()
    every = Sensitivity(forward).of(anchors, predictor.actions, part, wanted)
    for one, exact in zip(found.probes, every.probes, strict=True):
        assert one.keys() == exact.keys()
        for name in one:
            assert np.linalg.norm(one[name] - exact[name]) <= 0.02 * np.linalg.norm(exact[name]), name
    predictor.destroy()
