"""Terms of the picture: each is found again among the others, and its file keeps its word."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from bcid.forms import check_effect
from bcid.forms import effect_trial as trial
from bcid.forms.forward import Forward
from bcid.forms.model import Model, Term
from bcid.forms.simulate import recorded
from bcid.forms.solver.equilibrium import Settings
from bcid.grammar.effect_file import made, source
from bcid.grammar.observation_terms import observation_terms, observed_variant, picture_is_told
from bcid.grammar.timed import steady_variants, timed_families, variants_in_time
from bcid.inference.data import Data
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.mesh_error import MeshError
from bcid.predict.kept_predictions import MeasurementPrediction
from bcid.search.fitting.state import State

ANCHORS = frozenset({"left"})
SIGMA = 1e-5
FAMILIES = {family.name: family for family in observation_terms()}
# Of the picture, of each term.
TRUE = {
    "camera_shear": (0.02, -0.01, 0.015, 0.01, -0.02, 0.005),
    "camera_perspective": (0.04, -0.02, 0.03),
    "camera_distortion": (0.1,),
}


@pytest.fixture(scope="module")
def forward():
    found = Forward(trial.scene(), 0, MPI.COMM_SELF, Model.of(trial.scene()), Settings(rtol=1e-10), trial.box())
    yield found
    found.destroy()


def actions() -> list[Any]:
    """Twelve steps without a turn, there and back."""
    (one,) = trial.actions()
    part = np.sin(np.linspace(0.0, np.pi, 12))
    moved = part[:, None] * np.array([0.004, -0.002, 0.003])
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (len(part), 1))
    count = np.arange(len(part))
    return [
        replace(
            one, frames=count, numbers=None, steps=count, translation=moved, rotation=turns, loads={}, times=1.0 * count
        )
    ]


def compared(forward: Forward, seen: np.ndarray, predicted: np.ndarray) -> State:
    """What is seen, compared with what is predicted."""
    scene, made_of = trial.scene(), actions()
    measurement = recorded(scene, made_of, seen, SIGMA, np.random.default_rng(1))
    data = Data(scene, replace(measurement, noise_sigma=SIGMA))
    predictor: Any = SimpleNamespace(
        scene=scene, data=data, measurement=measurement, actions=made_of, forward=lambda model: forward,
        sensitivities=lambda *args: SimpleNamespace(probes=()), times=made_of[0].clock,
    )  # fmt: skip
    errors = ErrorCovariance(data, data.sigma, MeshError.unknown(data.mask.shape))
    prediction = MeasurementPrediction(predicted, {})
    return State(
        predictor, Model.of(scene), ANCHORS, prediction, errors, np.zeros((len(data), 1)), np.zeros((len(data), 0, 3))
    )


def left(state: State, columns: np.ndarray) -> tuple[np.ndarray, float]:
    """Amounts that explain the residual best, and chi-square per value of what they leave."""
    found = np.linalg.lstsq(columns, state.scaled, rcond=None)[0]
    return found, float(np.mean((state.scaled - columns @ found) ** 2))


@pytest.mark.parametrize("name", TRUE)
def test_a_distorted_picture_is_found_again(forward: Forward, name: str) -> None:
    positions = forward.predict(ANCHORS, actions()).positions
    terms = {
        key: Term(made(source(f, key, {}, "", ())), dict.fromkeys([p.name for p in f.amounts], 0.0))
        for key, f in FAMILIES.items()
    }
    true = terms[name].with_values(dict(zip(terms[name].values, TRUE[name], strict=True)))
    model = Model.of(trial.scene()) + true
    seen = np.array([model.observed(one, forward.frame(actions()[0], k)) for k, one in enumerate(positions)])
    state = compared(forward, seen, positions)
    assert picture_is_told(state)
    told = {key: left(state, observed_variant(state, term).sensitivity) for key, term in terms.items()}
    assert min(told, key=lambda key: told[key][1]) == name
    amounts, chi2 = told[name]
    assert chi2 < 1.3
    assert amounts == pytest.approx(TRUE[name], abs=2e-3)
    assert all(chi2 > 10 for key, (_, chi2) in told.items() if key != name)


def test_a_clock_that_drifts_is_found_again(forward: Forward) -> None:
    (action,), late = actions(), (-0.15, -0.35)
    positions = forward.predict(ANCHORS, [action]).positions
    steady = compared(forward, positions, positions)
    family = next(f for f in timed_families(steady, (), ("observation",)) if f.name == "time_lag_drifting")
    effect = made(source(family, "slow_clock", {}, "", ["Seen once."]))
    assert effect.name == "slow_clock"
    true = Term(effect, dict(zip([p.name for p in effect.amounts], late, strict=True)))
    moved = true.effect.driven(action, true.values)
    state = compared(forward, forward.predict(ANCHORS, [moved]).positions, positions)
    variants = variants_in_time(state, family, steady_variants(state, [family])["time_lag"])
    told = min((left(state, variant.sensitivity) for variant in variants), key=lambda one: one[1])
    assert told[0] == pytest.approx(late, abs=0.05)
    assert told[1] < 0.1 * float(np.mean(state.scaled**2))


@pytest.mark.parametrize("name", FAMILIES)
def test_the_file_of_a_term_of_the_picture_keeps_its_word(name: str) -> None:
    effect = made(source(FAMILIES[name], name, {}, "", ["What was found."]))
    assert [f.text for f in check_effect.findings(effect) if not f.ok] == []
