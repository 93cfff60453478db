"""The page of the theory: each equation names functions that exist, and they compute what it says."""

from __future__ import annotations

import importlib
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bcid.base.kriging import Kriging
from bcid.inference.discrepancy import Evidence
from bcid.inference.evidence import LinearParameters, MarginalLikelihood, log_gains
from bcid.inference.hypotheses import log_prior
from bcid.inference.mesh_error import MeshError
from bcid.inference.posterior import Fidelity, Pair, with_error
from bcid.inference.priors import PRIORS
from bcid.search.hypothesis_table import TangentEvidence, wrong_by

PAGE = (Path(__file__).resolve().parents[2] / "docs/theory.md").read_text(encoding="utf-8")
NAMES = sorted(set(re.findall(r"`(bcid\.[\w.]+)`", PAGE)))
EQUATIONS = re.findall(r"^\$\$ \((\w+)\)$", PAGE, re.MULTILINE)


def named(path: str) -> Any:
    """What a dotted path stands for: a module and attributes of it."""
    parts = path.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            found = getattr(found, part)
        return found
    raise AssertionError(path)


@pytest.mark.parametrize("path", NAMES)
def test_name_in_the_theory_is_that_of_something_documented(path: str) -> None:
    assert named(path).__doc__


def test_equation_is_followed_by_the_name_of_a_function() -> None:
    """Before the next one; that of the observation is what all others are made of."""
    parts = re.split(r"^\$\$ \(\w+\)$", PAGE, flags=re.MULTILINE)[1:]
    without = [name for name, text in zip(EQUATIONS, parts, strict=True) if "`bcid." not in text]
    assert (len(EQUATIONS), without) == (13, ["observation"])


def test_evidence_of_a_linear_model_is_its_gaussian_density() -> None:
    rng = np.random.default_rng(1)
    jacobian, width, apart = rng.normal(size=(6, 2)), np.array([0.5, 2.0]), np.array([0.3, -1.0])
    residual = rng.normal(size=6)
    free = np.zeros(2, dtype=bool)
    found = MarginalLikelihood.of(residual, LinearParameters(jacobian, apart, width[None], free)).log()
    covariance = np.eye(6) + (jacobian * width**2) @ jacobian.T
    expected = multivariate_normal(cov=covariance).logpdf(residual + jacobian @ apart)
    assert found == pytest.approx(expected + 3 * math.log(2 * math.pi), abs=1e-9)
    gain = log_gains(residual, jacobian[:, None], width[None], free)[0]
    alone = multivariate_normal(cov=np.eye(6)).logpdf(residual)
    assert gain == pytest.approx(multivariate_normal(cov=covariance).logpdf(residual) - alone, abs=1e-9)


def test_correction_of_second_order_meshes_is_exact_for_a_quadratic_error() -> None:
    exact, error = 2.0, 0.3
    coarse, fine = (np.full((1, 1, 3), exact + error / q**2) for q in (1, 2))
    found = MeshError.between(coarse, fine, 2.0**2 - 1)
    assert coarse + found.correction == pytest.approx(exact)
    assert np.abs(found.left) == pytest.approx(np.abs(fine - coarse) / 3)


def test_kriging_is_the_best_unbiased_estimate() -> None:
    rng = np.random.default_rng(2)
    points, places = rng.uniform(-1, 1, (12, 3)), rng.uniform(-1, 1, (5, 3))
    found = Kriging(points, 0.7, 0.2, 1.5)

    def matern(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        apart = math.sqrt(3) * np.linalg.norm(one[:, None] - other, axis=2) / 0.7
        return np.asarray((1 + apart) * np.exp(-apart))

    trend, at = (np.column_stack([np.ones(len(x)), x]) for x in (points, places))
    inverse, near = np.linalg.inv(matern(points, points) + 0.2 * np.eye(12)), matern(points, places)
    unmet = at.T - trend.T @ inverse @ near
    expected = inverse @ (near + trend @ np.linalg.solve(trend.T @ inverse @ trend, unmet))
    np.testing.assert_allclose(found.weights(places), expected.T, atol=1e-7)


def test_prior_odds_are_those_of_independent_effects_and_a_discrepancy() -> None:
    each = PRIORS.effects / 20
    assert log_prior(2, False, 20) == pytest.approx(2 * math.log(each / (1 - each)))
    assert log_prior(0, True, 20) == pytest.approx(math.log(PRIORS.discrepancy / (1 - PRIORS.discrepancy)))


@pytest.mark.parametrize(("low", "high"), [(2e3, 5e3), (-2e3, -5e3)])
def test_error_of_a_large_difference_is_the_logarithm_of_a_factor(low: float, high: float) -> None:
    assert Pair((), low, high).miss == pytest.approx(math.copysign(math.log(2.5), low), abs=1e-5)


def test_error_of_a_small_difference_is_one_of_some_nats() -> None:
    assert Pair((), 0.0, 0.03).miss == pytest.approx(0.03 / PRIORS.error_nats, rel=1e-4)


def test_errors_of_another_set_may_miss_a_hundredth_of_what_a_discrepancy_explains() -> None:
    here, there = Evidence(100.0, 400.0, 1.0), Evidence(-2000.0, 390.0, 1.0)
    shared, tangent = TangentEvidence(fidelity=Fidelity.SHARED), TangentEvidence()
    assert wrong_by(shared, here, there) == pytest.approx(3 + 23.9)
    assert wrong_by(shared, here, here) == pytest.approx(3 + 3)
    assert wrong_by(shared, Evidence(5.0, 4.0, 1.0), Evidence(5.0, 4.0, 1.0)) == 3
    assert wrong_by(tangent, here, there) == 3
    # The larger it is, the less a difference of a few nats says.
    one, other = (abs(float(with_error(np.array(-9.0), np.array(0.1), nats=nats)) + 9.0) for nats in (3.0, 87.0))
    assert other > 8 * one
