"""Rival effects: their evidence against numerical integration, and an exploration that finds the hidden one."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import quad, simpson
from scipy.stats import norm

from bcid.base.errors import InputError
from bcid.base.options import ExploreOptions
from bcid.exploration.explore_run import run_exploration
from bcid.exploration.fitted_numbers import FittedNumbers
from bcid.exploration.joined import joined
from bcid.exploration.loop import check, posterior_before
from bcid.exploration.moves import Move, limits_of
from bcid.forms.model import Model, Term
from bcid.forms.simulate import simulate
from bcid.inference.information import information
from bcid.inference.mesh_error import MeshError
from bcid.inference.priors import PRIORS
from bcid.measurement import Measurement
from bcid.predict.predictor import Predictor
from bcid.predict.pull_predictor import PullPredictor
from bcid.scene import Scene
from bcid.search.fitting.fit import fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.parameter_priors import of_state
from bcid.search.fitting.state import State

NOISE = 3e-4
WEIGHT = 1500.0


def test_information_about_a_spread_is_that_of_two_gaussians() -> None:
    """The same mean, but one hypothesis has an unknown number: by quadrature."""
    size = 4.0
    shown = np.zeros((2, 6))
    loose = [np.zeros((0, 6)), np.full((1, 6), size / math.sqrt(6))]
    found = information(shown, np.array([0.5, 0.5]), 4000, 1, loose)
    wide = math.hypot(1.0, size)

    def bits(x: float) -> float:
        logs = np.array([norm.logpdf(x), norm.logpdf(x, scale=wide)])
        mixture = np.logaddexp(*logs) - math.log(2)
        return 0.5 * float(np.exp(logs) @ (logs - mixture)) / math.log(2)

    exact = 2 * quad(bits, 0, 12 * wide, limit=200)[0]
    assert abs(found.bits - exact) < 4 * found.error + 1e-3
    assert information(shown, np.array([0.5, 0.5]), 4000, 1).bits == 0.0


@pytest.fixture
def heavy(coarse_scene: Path) -> tuple[Scene, Measurement]:
    """The coarse slab, and one pull at it with a weight that its scene does not know of."""
    scene = Scene.read(coarse_scene)
    model = Model.of(scene) + Term("gravity", {"weight": WEIGHT})
    action = Move("II", "out", limits_of(scene).displacement).action(limits_of(scene))
    return scene, simulate(scene, ["3", "4"], [action], 0, NOISE, 3, model=model)


def test_evidence_is_the_likelihood_averaged_over_what_was_believed(heavy: tuple[Scene, Measurement]) -> None:
    """Laplace's approximation against Simpson's rule over the weight, with predictions at every one of its values."""
    scene, seen = heavy
    predictor = Predictor(scene, seen, MPI.COMM_SELF)
    anchors, plain = frozenset("34"), Model.of(scene)
    start = State.of(predictor, plain + Term("gravity", {"weight": 1000.0}), anchors)
    one = FittedHypothesis.of(fit(start, ["gravity.weight"]), plain, 1)
    found = FittedNumbers.of(one, plain)
    assert found is not None
    value, error = found.amounts["gravity.weight"]
    assert value == pytest.approx(WEIGHT, abs=4 * error)
    numbers = of_state(one.fitted.state, plain, one.fitted.jacobian)
    assert numbers is not None
    # The smallest amounts cannot be seen.
    assert 0 < len(numbers.widths) < PRIORS.amounts[2]
    assert numbers.log_prior == pytest.approx(math.log(len(numbers.widths) / PRIORS.amounts[2]))
    at = value + error * np.linspace(max(-5.0, -value / error), 5, 21)
    chi2 = [
        State.of(predictor, start.model.with_values({"gravity.weight": w}), anchors, start.errors.mesh).chi2 for w in at
    ]
    # A weight is not negative: half of the prior is left.
    believed = np.mean([2 * norm.pdf(at, 0.0, width) for width in numbers.widths[:, 0]], axis=0)
    best = one.fitted.state.chi2
    averaged = simpson(np.exp(-0.5 * (np.array(chi2) - best)) * believed, x=at)
    volume = start.errors.log_volume
    exact = -0.5 * best - volume + math.log(averaged) + numbers.log_prior
    assert one.evidence.plain == pytest.approx(exact, abs=0.1)
    predictor.destroy()


def test_an_amount_of_which_more_does_the_same_had_to_be_expected(coarse_scene: Path) -> None:
    """A clock that is later than the gripper moves, where hardly anything moves: by the trapezoidal rule over the lag."""
    scene = Scene.read(coarse_scene)
    anchors, plain = frozenset("34"), Model.of(scene)
    action = Move("II", "out", limits_of(scene).displacement).action(limits_of(scene))
    slipping = plain + Term("grasp_slip", {"lag": 0.999})
    predictor = Predictor(scene, simulate(scene, ["3", "4"], [action], 0, NOISE, 3, model=slipping), MPI.COMM_SELF)
    whole = action.clock[-1]
    late = State.of(predictor, plain + Term("time_lag", {"seconds": 1.1 * whole}), anchors, free=("time_lag.seconds",))
    numbers = of_state(late, plain)
    assert numbers is not None
    at = whole * np.linspace(0.5, 1.0, 13)
    chi2 = [
        State.of(predictor, late.model.with_values({"time_lag.seconds": t}), anchors, late.errors.mesh).chi2 for t in at
    ]
    gains = np.exp(-0.5 * (np.array(chi2) - late.chi2))
    widths = numbers.widths[:, 0]
    believed = np.mean([norm.pdf(at, 0.0, width) for width in widths], axis=0)
    averaged = np.trapezoid(gains * believed, x=at) + np.mean(norm.sf(whole, 0.0, widths))
    exact = -0.5 * late.chi2 - late.errors.log_volume + math.log(averaged) + numbers.log_prior
    assert late.evidence(numbers).plain == pytest.approx(exact, abs=1.5)
    assert math.log(averaged) < -4
    predictor.destroy()


def test_what_no_pull_can_show_explains_nothing(heavy: tuple[Scene, Measurement]) -> None:
    """Springs at a patch that is not anchored do nothing: any stiffness fits, and they explain nothing."""
    scene, seen = heavy
    predictor = Predictor(scene, seen, MPI.COMM_SELF)
    anchors, plain = frozenset("34"), Model.of(scene)
    loose = plain + Term("soft_anchor", {"stiffness": 3e4}, place="2")
    one = fit(
        State.of(predictor, loose, anchors, MeshError.unknown(predictor.data.mask.shape)), ["soft_anchor(2).stiffness"]
    )
    dormant = FittedHypothesis.of(one, plain, 1)
    assert dormant.evidence.plain == -math.inf
    assert FittedNumbers.of(dormant, plain) is None
    predictor.destroy()


def test_pulls_are_joined_with_their_noise(heavy: tuple[Scene, Measurement]) -> None:
    scene, seen = heavy
    other = replace(seen, noise_sigma=2 * NOISE)
    whole = joined([seen, other], scene)
    assert whole.action_names == ["1", "2"]
    sigma = whole.sigma()
    assert sigma is not None
    count = len(seen.positions)
    assert (np.unique(sigma[:count]), np.unique(sigma[count:])) == (NOISE, 2 * NOISE)
    assert [list(a.frames) for a in whole.actions] == [list(range(count)), list(range(count, 2 * count))]


def test_a_hidden_weight_is_told_from_soft_anchors(coarse_scene: Path, tmp_path: Path) -> None:
    hidden = [f"gravity: weight = {WEIGHT} N/m^3"]
    plan = ExploreOptions(noise=NOISE, consider=("gravity", "soft_anchor"), samples=200)
    run_exploration(coarse_scene, "simulated:3,4", tmp_path / "run", plan, MPI.COMM_SELF, hidden=hidden)
    found = json.loads((tmp_path / "run/exploration.json").read_text())
    assert (found["reason"], found["anchored"], found["effect"]) == ("decided", ["3", "4"], "gravity")
    weight = found["parameters"]["gravity.weight"]
    assert weight["value"] == pytest.approx(WEIGHT, abs=4 * weight["stderr"])
    assert weight["unit"] == "N/m^3"
    # Noise is all there is: of what mesh and scene may have wrong nothing is.
    assert 0.8 < found["normalised_rms"] < 1.1
    text = (tmp_path / "run/summary.txt").read_text()
    assert "{3 4} + gravity" in text
    assert "told them apart most" in text
    # The scene alone explains nothing of it, and says so instead of naming a set.
    alone = replace(plan, consider=(), budget=2.0)
    run_exploration(coarse_scene, "simulated:3,4", tmp_path / "alone", alone, MPI.COMM_SELF, hidden=hidden)
    found = json.loads((tmp_path / "alone/exploration.json").read_text())
    assert found["reason"] != "decided"
    assert found["discrepancy_probability"] > 0.95


def test_an_effect_is_not_fitted_at_a_place_that_it_has_not(coarse_scene: Path) -> None:
    scene = Scene.read(coarse_scene)
    model = Model.of(scene) + Term("soft_anchor", {"stiffness": 3e5}, place="3")
    action = Move("II", "out", limits_of(scene).displacement).action(limits_of(scene))
    seen = simulate(scene, ["3", "4"], [action], 0, NOISE, 3, model=model)
    working = PullPredictor(scene, 0, MPI.COMM_SELF)
    posterior = posterior_before(scene, ExploreOptions(consider=("soft_anchor",)), working)
    found = posterior.after(seen)
    assert found is not None
    assert found.fitted
    for h, numbers in found.fitted.items():
        assert numbers.model.terms[-1].place in ("", *h.anchors)
    posterior.predictors.destroy()
    working.destroy()


@pytest.mark.parametrize(
    ("robot", "hidden", "words"),
    [
        ("folder:lab", "gravity: weight = 1 N/m^3", "belongs to a simulated robot"),
        ("simulated:1", "gravity", "expected as in"),
        ("simulated:1", "gravity: weight = 1", "weight"),
        ("simulated:1", "fibres: k1 = 5 kPa, angle", "expected as in"),
        ("simulated:1", "gravty: weight = 1 N/m^3", "gravity"),
    ],
)
def test_what_cannot_be_hidden_is_told(coarse_scene: Path, tmp_path: Path, robot: str, hidden: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        run_exploration(coarse_scene, robot, tmp_path / "run", ExploreOptions(), MPI.COMM_SELF, hidden=[hidden])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("name", "words"), [("gravty", "gravity"), ("gravity", "has it already")])
def test_wrong_effects_are_refused(coarse_scene: Path, name: str, words: str) -> None:
    scene = Scene.read(coarse_scene)
    with pytest.raises(InputError, match=words):
        check(ExploreOptions(consider=(name,)), replace(scene, effects={"gravity": {"weight": "1 N/m^3"}}))
