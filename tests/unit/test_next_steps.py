"""What would tell most: expected information against draws, and against what a number tells once it is measured."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from weighed_sets import POISSON, SIGMA, Sets, force

from bcid.inference.discrepancy import Evidence
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.mesh_error import MeshError
from bcid.results.diagnosis_record import NextStep
from bcid.search.answer.next_steps import (
    best_places,
    force_information,
    leading,
    next_steps,
    number_information,
    repeated,
    uncovered,
)

RNG = np.random.default_rng(2)


def test_number_information_is_that_of_draws() -> None:
    """Of hypotheses and of the number under each, whose density comes from errors made anew for each value."""
    sets = Sets.of(off=1.2)
    fitted, p = leading(sets.fitted)
    nodes = np.linspace(-5, 5, 101)
    errors = ErrorCovariance(sets.data, sets.data.sigma, MeshError.unknown(sets.data.mask.shape))
    densities = []
    for one in fitted:
        state, (_, plain), (_, forced) = one.rival.judged, *one.rival.weights.values()
        each = []
        for value in nodes:
            found = Evidence.of(errors, state.residual - value * sets.column, [force(errors)])
            each.append(np.logaddexp(found.plain + plain, found.forced + forced) - value**2 / 2)
        densities.append(np.exp(each - logsumexp(each)))
    drawn = RNG.choice(2, size=20_000, p=p)
    at = np.array([RNG.choice(len(nodes), p=densities[h]) for h in drawn])
    of = np.array(densities)
    bits = float(np.mean(np.log2(of[drawn, at] / (p @ of[:, at]))))
    assert 0.1 < bits < 0.95
    assert number_information(POISSON, fitted, p) == pytest.approx(bits, abs=0.02)


def test_a_number_that_is_measured_tells_what_was_open() -> None:
    open_case = Sets.of(off=1.5)
    fitted, p = leading(open_case.fitted)
    assert p.max() < 0.95
    assert number_information(POISSON, fitted, p) > 0.5 * -float(p @ np.log2(p))
    # The scene has the value of the first set, and knows it well.
    measured, shares = leading(Sets.of(tau=1e-3, off=1.5, value=1.5).fitted)
    assert measured[0].reported.anchors == frozenset("1")
    assert shares[0] > 0.99


def test_repeated_is_the_information_of_draws_of_the_whole_measurement() -> None:
    sets = Sets.of(off=0.5, apart=0.25)
    fitted, p = leading(sets.fitted)
    count = len(sets.data)
    covariance = np.eye(count) + np.outer(sets.column, sets.column) / SIGMA**2
    inverse = np.linalg.inv(covariance)
    clouds = [
        multivariate_normal(-inverse @ one.rival.judged.residual / SIGMA, 2 * np.eye(count) - inverse) for one in fitted
    ]
    bits = 0.0
    for share, own in zip(p, clouds, strict=True):
        seen = own.rvs(4000, random_state=5)
        logs = np.array([cloud.logpdf(seen) for cloud in clouds])
        bits += share * float(np.mean(logs[clouds.index(own)] - logsumexp(logs.T + np.log(p), axis=1))) / math.log(2)
    assert bits > 0.01
    assert repeated(fitted, p) == pytest.approx(bits, rel=0.1, abs=0.01)


def test_uncovered_is_small_where_a_nuisance_does_the_same() -> None:
    sets = Sets.of()
    shown = sets.fitted[0].rival.judged
    along = sets.data.spread(sets.column)
    for moved, least, most in ((np.nan_to_num(along), 0.0, 0.2), (SIGMA * RNG.normal(size=along.shape), 0.8, 1.0)):
        other = SimpleNamespace(predicted=shown.predicted + moved)
        both: Any = [sets.fitted[0], SimpleNamespace(rival=SimpleNamespace(judged=other))]
        assert least < uncovered(both, np.array([0.6, 0.4])) < most


def test_best_places_begins_where_hypotheses_differ() -> None:
    shown = np.zeros((2, 5, 6))
    shown[1, 3], shown[1, 1] = 1.0, 0.5
    chosen, bits = best_places(shown, np.array([0.5, 0.5]))
    assert chosen[:2] == [3, 1]
    assert 0 < bits[0] < bits[1] <= bits[2] + 0.05 <= 1.05


def test_force_information_counts_no_common_factor() -> None:
    """A body that is stiffer by an unknown factor pulls back by as much."""
    p, course = np.array([0.5, 0.5]), np.linspace(0, 1, 9)[:, None] * np.array([1.0, 0, 0])
    scaled, other = np.array([course, 1.1 * course]), np.array([course, course**2])
    assert force_information(scaled, p, 1.0, 0.0) > 0.9
    assert force_information(scaled, p, 1.0, 0.5) < 0.1
    assert force_information(other, p, 1.0, 0.5) > 0.9
    assert force_information(np.zeros((2, 3, 3)), p, 1.0, 0.5) == 0


def test_next_steps_are_none_for_what_is_certain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "bcid.search.answer.next_steps.predicted",
        lambda *_: [NextStep(kind="pull", text="pull grasp I", expected_bits=7.0)],
    )
    sets = Sets.of(off=1.5)
    found = sets.explanation
    steps = next_steps(found, sets.fitted)
    assert steps is not None
    assert steps.steps[0] == NextStep(kind="pull", text="pull grasp I", expected_bits=steps.open)
    assert any("Poisson's ratio (now known to 0.03)" in step.text for step in steps.steps)
    found.open = False
    assert next_steps(found, sets.fitted) is None
