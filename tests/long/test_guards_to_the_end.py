"""What must not be taken for a missing effect, by explanations from beginning to end; the fast ones are in verify/test_guards."""

from __future__ import annotations

from dataclasses import replace

import pytest
from mpi4py import MPI
from verify.test_guards import ANCHORED, FEW, NOISE, coarse, eight, inverting, plain, pulls  # noqa: F401

from bcid.base.options import ExplainOptions
from bcid.forms.forward import Forward
from bcid.forms.model import Model, Term
from bcid.forms.simulate import simulate
from bcid.inference.continuation import truncate_to_converged
from bcid.measurement import Measurement
from bcid.predict.levels import pair
from bcid.predict.predictor import Predictor
from bcid.scene import Level, Scene
from bcid.search.answer.explanation import Explanation
from bcid.search.answer.output import noise_warning
from bcid.search.explain import explain


@pytest.fixture(scope="module")
def slab(eight: Scene) -> Scene:
    """With all of its patches, of which there are 256 sets, and measured on a finer mesh."""
    return replace(eight, levels=(*eight.levels[:2], Level(2, 0.008)))


def test_a_stress_that_comes_and_goes_is_named(slab: Scene) -> None:
    model = Model.of(slab) + Term("active_stress", {"amplitude": 1200.0, "angle": 40.0, "period": 9.0})
    predictor = Predictor(slab, simulate(slab, ANCHORED, pulls(), level=2, model=model), MPI.COMM_SELF, level=1)
    found = explain(predictor, ExplainOptions(level=1))
    assert found.verdict == "active_stress"
    assert found.last.state.anchors == ANCHORED
    values = found.last.fitted.values
    assert values["active_stress.amplitude"] == pytest.approx(1200.0, rel=0.2)
    assert values["active_stress.angle"] == pytest.approx(40.0, abs=10.0)
    predictor.destroy()


def test_anchors_that_give_are_named_with_their_set(slab: Scene) -> None:
    """So soft that the sensitivity to a compliance from none says nothing of them, and a wrong rigid set fits best."""
    true = frozenset("13")
    model = Model.of(slab) + Term("soft_anchor", {"stiffness": 5e4})
    predictor = Predictor(slab, simulate(slab, true, pulls(), level=2, model=model), MPI.COMM_SELF, level=1)
    found = explain(predictor, ExplainOptions(level=1, only=FEW))
    assert (found.verdict, found.last.state.anchors) == ("soft_anchor", true)
    assert found.last.fitted.values["soft_anchor.stiffness"] == pytest.approx(5e4, rel=0.2)
    predictor.destroy()


def test_a_noise_that_is_stated_as_half_is_told(slab: Scene, plain: Measurement) -> None:
    predictor = Predictor(slab, replace(plain, noise_sigma=NOISE / 2), MPI.COMM_SELF, level=1)
    found = explain(predictor, ExplainOptions(level=1, only=FEW))
    assert found.noise is not None
    assert found.noise.factor == pytest.approx(2.0, rel=0.2)
    assert "stated as 0.1 mm" in noise_warning(found)
    assert (found.verdict, found.last.state.anchors) == ("none", ANCHORED)
    predictor.destroy()


def test_without_a_noise_nothing_is_certain_of_what_is_not_there(slab: Scene) -> None:
    """Smooth data, of which the second differences say that there is no noise."""
    smooth = simulate(slab, ANCHORED, pulls(), level=2, noise=0.0)
    scene = replace(slab, noise_sigma=None)
    predictor = Predictor(scene, replace(smooth, noise_sigma=None), MPI.COMM_SELF, level=1)
    found = explain(predictor, ExplainOptions(level=1, only=FEW))
    assert found.last.state.anchors == ANCHORED
    assert found.verdict == "none" or found.probability < 0.95
    assert found.last.adequacy.told is not True, "by a noise that was estimated from it nothing is adequate"
    assert noise_warning(found) == ""
    predictor.destroy()


def test_that_solves_fail_is_no_evidence_on_the_meshes_that_are_chosen(
    slab: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same, measured by cubic elements."""
    monkeypatch.setattr("bcid.predict.predictor.pair", pair)
    seen = simulate(replace(slab, levels=(Level(3, 0.016),)), ANCHORED, pulls(), level=0)
    monkeypatch.setattr(Forward, "predict", inverting)

    def work(measurement: Measurement) -> Explanation:
        return explain(Predictor(slab, measurement, MPI.COMM_SELF, level=1), ExplainOptions(level=1, only=FEW))

    found = truncate_to_converged(seen, work)
    assert (found.verdict, found.last.state.anchors) == ("none", ANCHORED)
