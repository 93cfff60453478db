"""Equation (2): probabilities from evidences at different fidelities, against integrals written out and against simulation."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats
from scipy.integrate import quad
from scipy.special import expit
from scipy.stats import t as student

from bcid.inference.hypotheses import Hypothesis
from bcid.inference.posterior import (
    Evaluation,
    Fidelity,
    FidelityStep,
    Kind,
    Pair,
    Posterior,
    Toggle,
    toggles,
    with_error,
)
from bcid.inference.priors import PRIORS

ALONE = Hypothesis(frozenset("1"))
OTHER = Hypothesis(frozenset("12"))
HEAVY = Hypothesis(frozenset("1"), "gravity")
FULL = Evaluation(0.0, 0.0)
LOSING = Kind(Fidelity.TANGENT, effect=False, gains=False)


def known(h: Hypothesis, gain: float, fidelity: Fidelity = Fidelity.TANGENT, log_prior: float = 0.0) -> Evaluation:
    """A hypothesis against the one that holds patch 1 alone."""
    about = ALONE if fidelity == Fidelity.TANGENT else None
    return Evaluation(gain, log_prior, (FidelityStep(0.0, 0.0, toggles(fidelity, h, ALONE, gain)),), about)


def _raised(one: Evaluation, by: float) -> Evaluation:
    """The same with more evidence, and so that it is known against, and other prior odds."""
    steps = tuple(FidelityStep(step.low + by, step.high + by, step.toggles) for step in one.steps)
    return replace(one, start=one.start + by, log_prior=one.log_prior + 7, steps=steps)


def differing(gain: float, error: float) -> float:
    """A factor where it is large, some nats where it is small: half of x plus the root of x^2 + a^2, times the factor."""
    grown = math.exp(error) * (gain + math.hypot(gain, PRIORS.error_nats))
    return (grown - PRIORS.error_nats**2 / grown) / 2


def pair(patches: str, low: float, high: float) -> Pair:
    return Pair(toggles(Fidelity.TANGENT, Hypothesis(frozenset(patches)), ALONE, low), low, high)


def test_toggles_patches_and_effects_in_which_hypotheses_differ_are_named() -> None:
    one, other = Hypothesis(frozenset("12"), "gravity+fibres"), Hypothesis(frozenset("23"), "fibres")
    found = toggles(Fidelity.COARSE, one, other, 2.0)
    assert [(t.kind.effect, t.name) for t in found] == [(False, "1"), (False, "3"), (True, "gravity")]
    assert {(t.kind.fidelity, t.kind.gains) for t in found} == {(Fidelity.COARSE, True)}
    assert {t.kind.gains for t in toggles(Fidelity.TANGENT, one, other, 2.0)} == {True}
    assert {t.kind.gains for t in toggles(Fidelity.TANGENT, one, other, -2.0)} == {False}
    assert toggles(Fidelity.TANGENT, Hypothesis(frozenset("1"), "", unknown=True), ALONE, 1.0) == ()


def test_probabilities_all_at_full_fidelity_are_evidence_times_prior() -> None:
    found = Posterior({ALONE: Evaluation(-3.0, 0.0), HEAVY: Evaluation(-1.0, -1.5)}).probabilities()
    assert found == pytest.approx({HEAVY: 1 / (1 + math.exp(-0.5)), ALONE: 1 / (1 + math.exp(0.5))})
    assert list(found) == [HEAVY, ALONE]
    assert Posterior({}).probabilities() == {}


@pytest.mark.parametrize(
    ("fidelity", "gain"),
    [
        (Fidelity.TANGENT, -4.0),
        (Fidelity.COARSE, -2.0),
        (Fidelity.TANGENT, -0.1),
        (Fidelity.TANGENT, 1.5),
        (Fidelity.COARSE, 8.0),
        (Fidelity.SHARED, -2.0),
    ],
)
def test_probabilities_one_hypothesis_below_is_the_expectation_over_its_error(fidelity: Fidelity, gain: float) -> None:
    """Bias and error of one toggle without pairs: a Student distribution with four degrees of freedom; a gain may become a loss."""
    scale, ceiling = (
        math.sqrt(2) * PRIORS.fidelity_error[{Fidelity.TANGENT: 0, Fidelity.COARSE: 2, Fidelity.SHARED: 3}[fidelity]],
        3.0,
    )

    def share(error: float) -> float:
        log = min(differing(gain, error), ceiling) - 0.5
        return float(student.pdf(error, PRIORS.error_freedom, scale=scale) * expit(log))

    expected = quad(share, -40, 40, points=[-2, 0, 2], limit=400)[0]
    posterior = Posterior({ALONE: FULL, OTHER: known(OTHER, gain, fidelity, -0.5)}, ceiling=ceiling)
    assert posterior.probabilities()[OTHER] == pytest.approx(expected, abs=0.01)


def test_probabilities_many_unlikely_hypotheses_do_not_win_together() -> None:
    """Each with an error of its own, some of a thousand would always be drawn as likely."""
    sets = [Hypothesis(frozenset(s)) for count in range(11) for s in combinations("0123456789", count)]
    table = {h: known(h, -30.0 * len(h.anchors ^ ALONE.anchors)) for h in sets if h != ALONE}
    found = Posterior({ALONE: FULL, **table}).probabilities()
    assert sum(found.values()) == pytest.approx(1.0)
    assert found[ALONE] > 0.9


def test_probabilities_tangents_that_showed_too_much_leave_others_open() -> None:
    """As far as they may be as likely as what they are known against, and no further."""
    table = {ALONE: FULL, OTHER: known(OTHER, -20.0)}
    right, wrong = ([pair(f"1{n}", -20.0, high) for n in "345"] for high in (-20.0, -1.0))
    sure, doubtful = (Posterior(table, pairs).probabilities()[OTHER] for pairs in (right, wrong))
    assert sure < 0.005 < 0.02 < doubtful < 0.5


def test_probabilities_promise_never_exceeds_what_explains_all() -> None:
    promise = {ALONE: FULL, HEAVY: known(HEAVY, 1000.0)}
    found = Posterior(promise, ceiling=2.0).probabilities()
    assert found[HEAVY] == pytest.approx(expit(2.0), abs=1e-3)


def test_probabilities_error_of_a_toggle_is_shared_by_all_hypotheses_with_it() -> None:
    """What is known of patch 2 from one set says what it does in another."""
    one = pair("12", -10.0, -200.0)
    two, three = (Hypothesis(frozenset(s)) for s in ("124", "134"))
    mean, _, freedom = Posterior({}, [one]).learned(LOSING, (Toggle(LOSING, "2"), Toggle(LOSING, "3")))
    assert mean[0] < -0.5
    assert mean[1] == 0.0
    assert freedom == PRIORS.error_freedom + 1
    found = Posterior({ALONE: FULL, two: known(two, -3.0), three: known(three, -3.0)}, [one]).probabilities()
    assert found[two] < found[three]


def test_probabilities_order_and_offset_change_nothing() -> None:
    table = {ALONE: FULL, OTHER: known(OTHER, -3.0), HEAVY: known(HEAVY, -2.0, Fidelity.COARSE, -3.0)}
    pairs = [pair("12", -3.0, -4.0)]
    found = Posterior(table, pairs, 0.5).probabilities()
    assert Posterior(dict(reversed(table.items())), pairs, 0.5).probabilities() == pytest.approx(found)
    moved = {h: _raised(one, 1e3) for h, one in table.items()}
    assert Posterior(moved, pairs, 1000.5).probabilities() == pytest.approx(found)


def test_pair_that_cannot_be_computed_is_left_out() -> None:
    pairs = [pair("12", -3.0, -math.inf), pair("12", math.nan, 1.0), pair("1", -1.0, -2.0)]
    assert Posterior({}, pairs).pairs == []


@pytest.mark.parametrize(("low", "high"), [(-20.0, -40.0), (-20.0, 300.0), (20.0, 5.0), (20.0, 40.0), (0.0, 2.0)])
def test_pair_misses_by_the_error_that_leads_from_one_difference_to_the_other(low: float, high: float) -> None:
    assert differing(low, pair("12", low, high).miss) == pytest.approx(high)


def test_pair_whose_gain_turned_into_a_loss_has_nothing_left_of_it() -> None:
    small, large = (pair("12", 20.0, high).miss for high in (-3.0, -1e9))
    assert small == large
    assert differing(20.0, large) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("low", "high", "fails"), [(90.0, -5e3, True), (-2.0, -200.0, True), (90.0, -5.0, False)])
def test_fit_that_loses_more_by_an_effect_than_that_costs_tells_nothing_of_others(
    low: float, high: float, fails: bool
) -> None:
    acting = Hypothesis(ALONE.anchors, "gravity")
    found = Posterior({}, [Pair(toggles(Fidelity.TANGENT, acting, ALONE, low), low, high)])
    assert len(found.pairs) == (not fails)


@given(gain=floats(-1e4, 1e4), error=floats(-3, 3), room=floats(0, 1e4))
def test_with_error_gains_end_where_all_is_explained(gain: float, error: float, room: float) -> None:
    found = float(with_error(np.array(gain), np.array(error), room))
    assert found <= (room + PRIORS.error_nats) * (1 + 1e-12)
    assert float(with_error(np.array(gain), np.array(0.0), room)) == pytest.approx(min(gain, room), rel=1e-6, abs=1e-6)
    if gain <= 0:
        assert (error > 0) == (found > gain) or abs(error) < 1e-9


def test_with_error_what_is_left_falls_exponentially() -> None:
    """With half of it explained three times as much leaves an eighth; a small gain is as if there were no end."""
    whole = 1e4 + PRIORS.error_nats
    half = with_error(np.array(whole / 2), np.array(math.log(3)), 1e4)
    assert float(half) == pytest.approx(whole * 7 / 8, rel=1e-3)
    few = with_error(np.array(-1.0), np.array(1.0), 1e4)
    assert float(few) == pytest.approx(differing(-1.0, 1.0), rel=1e-2)


def test_pair_that_explains_all_missed_by_more_than_the_factor() -> None:
    """Of a misfit of 100 nats a tangent shows half, and all steps nearly all."""
    end = Pair((), 50.0, 99.0, 100.0)
    assert end.miss > 1.5 > Pair((), 50.0, 99.0).miss
    assert float(with_error(np.array(50.0), np.array(end.miss), 100.0)) == pytest.approx(99.0)


def test_learned_errors_drawn_from_the_prior_lie_within_their_intervals() -> None:
    """Simulation-based calibration of the errors: given the pairs of others, as many are within an interval as it says."""
    generator, names, inside = np.random.default_rng(3), "abcdef", []
    for _ in range(400):
        scale = PRIORS.fidelity_error[0] * math.sqrt(PRIORS.error_freedom / generator.chisquare(PRIORS.error_freedom))
        bias, own = scale * generator.normal(), scale * generator.normal(size=len(names))
        misses = bias + own[:-1] + scale * generator.normal(size=len(names) - 1)
        pairs = [Pair((Toggle(LOSING, n),), -1e4, -1e4 * math.exp(-m)) for n, m in zip(names, misses, strict=False)]
        last = Toggle(LOSING, names[-1])
        mean, root, freedom = Posterior({}, pairs).learned(LOSING, (last.bias, last))
        spread = math.sqrt(float(np.sum(np.sum(root, axis=0) ** 2)))
        inside.append(abs(bias + own[-1] - mean.sum()) < spread * student.ppf(0.9, freedom))
    assert np.mean(inside) == pytest.approx(0.8, abs=0.06)


def test_order_few_steps_come_before_a_tangent_and_a_tangent_about_what_fits_well_before_others() -> None:
    """Not by the gain: a tangent that shows hardly any difference from what fits badly is no more exact for that."""
    coarse, tangent = known(OTHER, -30.0, Fidelity.COARSE), known(OTHER, -30.0)
    worse = _raised(known(OTHER, -1.0), -25.0)
    assert sorted([worse, tangent, coarse], key=lambda one: one.order({})) == [coarse, tangent, worse]
