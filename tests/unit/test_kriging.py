"""Smooth fields from points with noise: exact where they are linear, and no further off than they say."""

from __future__ import annotations

import numpy as np
import pytest

from bcid.base.kriging import Kriging

RNG = np.random.default_rng(5)
POINTS = RNG.uniform(-1, 1, (40, 3))
PLACES = RNG.uniform(-1, 1, (60, 3))


def linear(at: np.ndarray) -> np.ndarray:
    return np.column_stack([1 + at @ [0.3, -0.2, 0.5], at @ [0.0, 1.0, 0.0] - 2])


@pytest.mark.parametrize("noise", [None, 1e-3])
def test_kriging_is_exact_for_a_linear_field(noise: float | None) -> None:
    """Whatever the length and the noise: it is estimated without bias."""
    found = Kriging.of(POINTS, linear(POINTS), noise)
    np.testing.assert_allclose(found.weights(PLACES) @ linear(POINTS), linear(PLACES), atol=1e-7)


def field(at: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Waves that nobody has told it of."""
    return np.column_stack([np.sin(2 * at @ one) * np.cos(at @ one[::-1]) for one in directions])


@pytest.mark.parametrize("count", [20, 40])
@pytest.mark.parametrize("noise", [1e-3, 0.1])
def test_kriging_is_not_further_off_than_it_says(count: int, noise: float) -> None:
    points, directions = POINTS[:count], RNG.normal(size=(30, 3)) / np.sqrt(3)
    seen = field(points, directions) + noise * RNG.normal(size=(count, 30))
    found = Kriging.of(points, seen, noise)
    off = field(PLACES, directions) - found.weights(PLACES) @ seen
    said = np.diag(found.covariance(PLACES, PLACES)) + noise**2 * np.sum(found.weights(PLACES) ** 2, axis=1)
    assert 0.5 < np.mean(off**2) / np.mean(said) < 1.5
    assert found.noise == pytest.approx(noise)


def test_kriging_finds_the_noise_that_nobody_states() -> None:
    directions = RNG.normal(size=(30, 3)) / np.sqrt(3)
    seen = field(POINTS, directions) + 0.1 * RNG.normal(size=(40, 30))
    assert Kriging.of(POINTS, seen).noise == pytest.approx(0.1, rel=0.4)


def test_kriging_modes_add_up_to_the_covariance() -> None:
    found = Kriging.of(POINTS, field(POINTS, np.eye(3)), 0.01)
    noise, between = found.error_modes(PLACES, PLACES, 60)
    weights = found.weights(PLACES)
    np.testing.assert_allclose(noise @ noise.T, weights @ weights.T, atol=0.05 * np.abs(weights @ weights.T).max())
    expected = found.covariance(PLACES, PLACES)
    np.testing.assert_allclose(between @ between.T, expected, atol=0.05 * np.abs(expected).max())


@pytest.mark.parametrize("count", [3, 4, 5])
def test_kriging_takes_few_points_or_points_on_a_line(count: int) -> None:
    points = np.linspace(0, 1, count)[:, None] * [0.0, 1.0, 0.0]
    found = Kriging.of(points, np.full((count, 2), 3.0), 0.1)
    np.testing.assert_allclose(found.weights(PLACES).sum(axis=1), 1.0, atol=1e-6)
