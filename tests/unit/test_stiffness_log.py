"""The stiffness of a body by its logarithm: never negative, and exact where the data decide."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from bcid.inference.stiffness import log_factor


def posterior(mean: float, error: float, prior: float) -> tuple[float, float]:
    """Posterior mean and standard deviation of a factor with a Gaussian prior about one, as the covariance gives them."""
    precision = 1 / error**2 + 1 / prior**2
    return ((mean / error**2 + 1 / prior**2) / precision) - 1, precision**-0.5


def test_log_factor_sharp_data_gives_their_factor() -> None:
    log, error = log_factor(*posterior(1.3, 0.01, 0.5), 0.5)
    assert math.exp(log) == pytest.approx(1.3, rel=1e-3)
    assert error == pytest.approx(0.01 / 1.3, rel=0.02)


@pytest.mark.parametrize("mean", [-1.9, -0.2, 0.0])
def test_log_factor_force_of_the_wrong_sign_is_a_small_stiffness_and_uncertain(mean: float) -> None:
    """A linear estimate would be negative: -28 ± 11 kPa of a body of 15 kPa was reported."""
    log, error = log_factor(*posterior(mean, 0.7, 2.0), 2.0)
    assert 0 < math.exp(log) < 1
    assert error > 0.5


def test_log_factor_without_data_is_the_prior() -> None:
    assert log_factor(0.0, 0.5, 0.5) == (0.0, 0.5)


@pytest.mark.parametrize(("mean", "error"), [(1.2, 0.1), (0.6, 0.15), (2.0, 0.5)])
def test_log_factor_is_near_the_posterior_by_quadrature(mean: float, error: float) -> None:
    def density(log: float) -> float:
        return math.exp(-0.5 * ((math.exp(log) - mean) / error) ** 2 - 0.5 * (log / 0.5) ** 2)

    whole = quad(density, -6, 4)[0]
    middle = quad(lambda x: x * density(x), -6, 4)[0] / whole
    spread = math.sqrt(quad(lambda x: (x - middle) ** 2 * density(x), -6, 4)[0] / whole)
    found, stated = log_factor(*posterior(mean, error, 0.5), 0.5)
    # The mode of a skewed posterior lies a part of its width from its mean.
    assert abs(found - middle) < 0.35 * spread
    assert stated == pytest.approx(spread, rel=0.25)
    assert np.isfinite([found, stated]).all()
