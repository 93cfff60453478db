"""Evidence against Gaussians written out in full, and what is believed of hypotheses."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from bcid.inference.data import Data, Noise, robust_noise
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.evidence import (
    LARGER,
    KnownNuisance,
    LinearParameters,
    LowRankDiscrepancy,
    MarginalLikelihood,
    log_gains,
)
from bcid.inference.hypotheses import (
    Hypothesis,
    HypothesisOdds,
    log_prior,
    patches,
)
from bcid.inference.mesh_error import MeshError
from bcid.inference.priors import PRIORS

Array = NDArray[np.float64]
COUNT = 60
RNG = np.random.default_rng(1)
COLUMNS = RNG.normal(size=(COUNT, 2))
PUSHES = RNG.normal(size=(COUNT, 9))
RESIDUAL = RNG.normal(size=COUNT) + COLUMNS @ [2.0, -1.0]
WIDTHS = np.array([[0.5, 1.0], [3.0, 6.0]])
CONSTANT = COUNT / 2 * math.log(2 * math.pi)


def numbers(apart: Array | None = None, positive: bool = False) -> LinearParameters:
    return LinearParameters(
        COLUMNS, np.zeros(2) if apart is None else apart, WIDTHS, np.array([positive, False]), math.log(0.25)
    )


def written_out(residual: Array, widths: Array, pushes: Array | None = None) -> float:
    """The density with the full covariance."""
    covariance = np.eye(COUNT) + (COLUMNS * widths**2) @ COLUMNS.T
    covariance += 0.0 if pushes is None else pushes @ pushes.T
    return float(multivariate_normal(cov=covariance).logpdf(residual)) + CONSTANT


def test_numbers_are_integrated_over() -> None:
    expected = logsumexp([written_out(RESIDUAL, row) for row in WIDTHS]) - math.log(2) + math.log(0.25)
    assert MarginalLikelihood.of(RESIDUAL, numbers()).log() == pytest.approx(expected)


def test_about_a_fit_the_same_is_found() -> None:
    """The model is linear: whether the residual is that of the fit or that without the effect does not matter."""
    best = np.linalg.lstsq(COLUMNS, RESIDUAL, rcond=None)[0]
    assert MarginalLikelihood.of(RESIDUAL - COLUMNS @ best, numbers(best)).log() == pytest.approx(
        MarginalLikelihood.of(RESIDUAL, numbers()).log()
    )


def test_a_force_is_integrated_over_with_the_numbers() -> None:
    sizes = np.array([0.1, 0.7])
    force = LowRankDiscrepancy.of(PUSHES, sizes)
    each = [written_out(RESIDUAL, row, size * PUSHES) for size in sizes for row in WIDTHS]
    found = MarginalLikelihood.of(RESIDUAL, numbers(), force).log()
    assert found == pytest.approx(logsumexp(each) - math.log(4) + math.log(0.25))
    pushed = RNG.normal(size=COUNT) + 0.7 * PUSHES @ RNG.normal(size=9)
    assert force.sizes[np.argmax(MarginalLikelihood.of(pushed, LinearParameters.none(COUNT), force).forced)] == 0.7


def test_an_amount_that_cannot_be_negative() -> None:
    """Against the integral over the half of the prior that is left."""
    column, width = COLUMNS[:, :1], np.array([[1.5]])
    for sign in (1.0, -1.0):
        residual = sign * RESIDUAL
        one = LinearParameters(column, np.zeros(1), width, np.array([True]))

        def density(amount: float, residual: Array = residual) -> float:
            squares = float(np.sum((residual - amount * column[:, 0]) ** 2) - np.sum(residual**2))
            return 2 * float(norm.pdf(amount, scale=1.5)) * math.exp(-0.5 * squares)

        integral = math.log(quad(density, 0, 30, points=[0.5, 1, 2, 4])[0])
        nothing = MarginalLikelihood.of(residual, LinearParameters.none(COUNT)).log()
        assert MarginalLikelihood.of(residual, one).log() - nothing == pytest.approx(integral, abs=1e-6)


def test_many_variants_at_once() -> None:
    """Each as by itself."""
    stacked = np.stack([COLUMNS, COLUMNS[:, ::-1], RNG.normal(size=(COUNT, 2))], axis=1)
    positive = np.array([False, True])
    gains = log_gains(RESIDUAL, stacked, WIDTHS, positive)
    for gain, columns in zip(gains, np.moveaxis(stacked, 1, 0), strict=True):
        alone = LinearParameters(columns, np.zeros(2), WIDTHS, positive)
        nothing = MarginalLikelihood.of(RESIDUAL, LinearParameters.none(COUNT)).log()
        assert gain == pytest.approx(MarginalLikelihood.of(RESIDUAL, alone).log() - nothing)


def test_errors_that_are_known_but_for_a_factor() -> None:
    none = LinearParameters.none(COUNT)
    for factor in (1.0, 5.0):
        values = [
            multivariate_normal(cov=one**2 * np.eye(COUNT)).logpdf(factor * RESIDUAL) + CONSTANT for one in LARGER
        ]
        found = MarginalLikelihood.of(factor * RESIDUAL, none).log(LARGER)
        assert found == pytest.approx(logsumexp(values) - math.log(len(values)))
    # Errors five times as large as stated are no surprise then, and a great one else.
    assert MarginalLikelihood.of(5 * RESIDUAL, none).log(LARGER) > MarginalLikelihood.of(5 * RESIDUAL, none).log() + 100


@pytest.mark.parametrize("larger", [1 / 3, 3.0])
def test_a_prior_that_is_three_times_as_wide_changes_little(larger: float) -> None:
    plain, wider = numbers(), LinearParameters(COLUMNS, np.zeros(2), larger * WIDTHS, np.zeros(2, bool), math.log(0.25))
    assert MarginalLikelihood.of(RESIDUAL, wider).log() == pytest.approx(
        MarginalLikelihood.of(RESIDUAL, plain).log(), abs=3.0
    )


@pytest.mark.parametrize("forced", [False, True])
def test_evidence_of_a_known_nuisance_is_that_without_its_column(forced: bool) -> None:
    """Written out in full; and its mean over what the nuisance may be is the evidence where it is not known."""
    size = 0.7
    column = 0.2 * RNG.normal(size=COUNT)
    pushes = size * PUSHES if forced else np.zeros((COUNT, 1))
    root = np.linalg.cholesky(np.eye(COUNT) + np.outer(column, column))
    # All is in units of errors that hold the column.
    known = KnownNuisance(np.linalg.solve(root, column), np.array([-2.0, 0.0, 2.0]))
    scaled = LinearParameters(np.linalg.solve(root, COLUMNS), np.zeros(2), WIDTHS, np.zeros(2, bool), math.log(0.25))
    force = LowRankDiscrepancy.of(np.linalg.solve(root, PUSHES), np.array([size])) if forced else None
    residual = np.linalg.solve(root, RESIDUAL)
    volume = float(np.sum(np.log(np.diag(root))))
    wanted = [
        logsumexp([written_out(RESIDUAL - value * column, row, pushes) for row in WIDTHS]) - math.log(8)
        for value in known.values
    ]
    assert MarginalLikelihood.of(residual, scaled, force, known).logs() - volume == pytest.approx(wanted)
    nodes, weights = np.polynomial.hermite_e.hermegauss(120)
    each = MarginalLikelihood.of(residual, scaled, force, replace(known, values=nodes)).logs()
    mean = logsumexp(each, b=weights / weights.sum())
    assert mean == pytest.approx(MarginalLikelihood.of(residual, scaled, force).log(), abs=1e-6)


# -- hypotheses
# ------------------------------------------------------------------------------------------------------------------


def test_the_prior_of_hypotheses() -> None:
    """Every effect acts with the same probability, whatever else does."""
    each, unknown = PRIORS.effects / 18, PRIORS.discrepancy / (1 - PRIORS.discrepancy)
    assert log_prior(0, False, 18) == 0.0
    assert log_prior(1, False, 18) == pytest.approx(math.log(each / (1 - each)))
    assert log_prior(2, True, 18) == pytest.approx(2 * math.log(each / (1 - each)) + math.log(unknown))


def test_what_is_believed_is_told_by_verdict_and_by_patch() -> None:
    a, b = frozenset("12"), frozenset("13")
    odds = HypothesisOdds.of(
        {
            Hypothesis(a): math.log(0.3),
            Hypothesis(a, "gravity"): math.log(0.25),
            Hypothesis(b, "gravity"): math.log(0.2),
            Hypothesis(b, "gravity", True): math.log(0.15),
            Hypothesis(b, "", True): math.log(0.1),
        }
    )
    assert odds.verdicts == pytest.approx({"gravity": 0.45, "none": 0.3, "unknown": 0.25})
    assert odds.best == Hypothesis(a, "gravity")
    assert odds.held_by(b) == pytest.approx(0.45)
    assert patches(odds.probabilities, "123") == pytest.approx({"1": 1.0, "2": 0.55, "3": 0.45})


def test_terms_that_write_the_same_are_one_verdict() -> None:
    """Which of them it is may be open although it is one of them."""
    a = frozenset("12")
    parts = {"exponential": 0.25, "power": 0.24}
    logs = {Hypothesis(a, name): math.log(part) for name, part in parts.items()}
    logs |= {Hypothesis(a, "power", True): math.log(0.2), Hypothesis(a, "", True): math.log(0.21)}
    assert HypothesisOdds.of(logs).best == Hypothesis(a, "", True)
    assert HypothesisOdds.of(logs, alike=True).best == Hypothesis(a, "exponential")


# -- the noise of a residual
# ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("factor", "surprising"), [(1.0, False), (2.0, True), (0.5, True)])
def test_a_noise_that_is_stated_wrongly_is_seen(factor: float, surprising: bool) -> None:
    from tests.unit.test_compare import SIGMA, actions, data_of, rest

    made = actions(steps=20)
    data = data_of(rest(made), made)
    residual = factor * SIGMA * np.random.default_rng(2).normal(size=len(data))
    # One fiducial that jumps is no noise.
    residual[(data.fiducial == 0) & (data.frame > 30)] += 5e-3
    found = robust_noise(data, residual + 1e-3 * data.progress**2)
    assert found is not None
    assert found.surprising == surprising
    assert found.sigma == pytest.approx(factor * SIGMA, rel=0.15)
    believed = data.with_noise(found)
    assert believed.sigma == pytest.approx(np.full(len(data), found.sigma))
    assert believed.stated
    # What of a stated noise is none may still be an error that persists.
    persists = SIGMA * np.sqrt(max(1 - found.factor**2, 0.0)) if surprising else believed.slow[0]
    assert believed.slow == pytest.approx(np.full(len(data), persists))
    assert not data.slow.any()
    assert data.sigma == pytest.approx(np.full(len(data), SIGMA))


def test_an_error_that_persists_is_expected_where_more_was_stated_than_is_noise() -> None:
    """As of image correlation: each trajectory is off by what was stated, and hardly changes from step to step."""
    from tests.unit.test_compare import SIGMA, actions, data_of, rest

    made = actions(steps=20)
    data = data_of(rest(made), made)
    rng = np.random.default_rng(3)
    offset = SIGMA * rng.normal(size=data.trajectory.max() + 1)
    residual = offset[data.trajectory] * np.minimum(1.0, 4 * data.progress) + 0.05 * SIGMA * rng.normal(size=len(data))
    found = robust_noise(data, residual)
    assert found is not None
    assert found.factor == pytest.approx(0.05, rel=0.2)
    believed = data.with_noise(found)
    mesh = MeshError.unknown(data.mask.shape)
    chi2 = [
        float(np.mean(ErrorCovariance(d, d.sigma, mesh).whiten(residual) ** 2)) for d in (believed, within(believed))
    ]
    assert chi2[0] == pytest.approx(1.0, abs=0.3)
    assert chi2[1] > 100


def within(data: Data) -> Data:
    """The same with nothing but noise."""
    other = copy(data)
    other.slow = np.zeros(len(data))
    return other


def test_where_no_noise_is_stated_one_can_be_believed() -> None:
    from tests.unit.test_compare import actions, data_of, rest

    made = actions()
    data: Data = data_of(rest(made), made, None).with_noise(Noise(3e-4, 1.0, 0.1))
    assert not data.stated
    assert data.noise(np.zeros(len(data))) == pytest.approx(np.full(len(data), 3e-4))
