"""The misfit in observation space: its covariance, what it does to the evidence, and what it leaves alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from unit.test_compare import SIGMA, actions, data_of, rest

from bcid.inference import response
from bcid.inference.data import Data
from bcid.inference.discrepancy import Evidence
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.evidence import LowRankDiscrepancy
from bcid.inference.mesh_error import MeshError
from bcid.inference.priors import PRIORS

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def data() -> Data:
    made = actions(steps=6)
    still = data_of(rest(made), made)
    moved = rest(made)
    # The markers move by about as much as the gripper does.
    moved[still.frame, still.fiducial, still.axis] += 200 * SIGMA * still.way
    return data_of(moved, made)


@pytest.fixture(scope="module")
def errors(data: Data) -> ErrorCovariance:
    return ErrorCovariance(data, data.sigma, MeshError.unknown(data.mask.shape))


def no_force(data: Data) -> list[LowRankDiscrepancy]:
    """A force that moves nothing: the discrepancy in observation space stands alone."""
    return [LowRankDiscrepancy.of(np.zeros((len(data), 1)), np.array([1.0]))]


def smooth_misfit(data: Data, size: float) -> Array:
    """One that is linear in the pose and over the markers, in m."""
    places = data.rest[data.fiducial]
    slope = (places[:, 0] - places[:, 0].mean()) / max(float(np.ptp(places[:, 0])), 1e-12)
    return size * data.way * (1 + slope)


def test_columns_have_the_stated_rank_and_size(data: Data) -> None:
    for columns in response.columns(data):
        assert len(columns) == len(data)
        assert columns.shape[1] <= PRIORS.misfit_columns
        largest = float(np.sum(columns**2, axis=1).max())
        # The linear part has a variance of one at the furthest pose, and the smooth part adds its own.
        assert largest <= 1 + PRIORS.misfit_smooth[0] + 1e-9


def test_columns_reproduce_the_kernel_of_few_poses(data: Data) -> None:
    """With a long correlation over markers few columns are needed, and their covariance is that of the docstring."""
    columns = response.columns(data)[-1]
    pose = response.poses(data)[data.frame]
    place = data.rest[data.fiducial]
    length = PRIORS.misfit_lengths[-1] * float(np.linalg.norm(np.ptp(data.rest, axis=0)))
    apart = np.sum((place[:, None] - place) ** 2, axis=2)
    turned = np.sum((pose[:, None] - pose) ** 2, axis=2)
    over_poses = pose @ pose.T + PRIORS.misfit_smooth[0] * np.exp(-0.5 * turned / PRIORS.misfit_smooth[1] ** 2)
    expected = np.exp(-0.5 * apart / length**2) * over_poses * (data.axis[:, None] == data.axis)
    assert np.linalg.norm(columns @ columns.T - expected) < 0.05 * np.linalg.norm(expected)


def test_evidence_with_a_misfit_is_the_gaussian_written_out(data: Data, errors: ErrorCovariance) -> None:
    residual = smooth_misfit(data, 5 * SIGMA) + SIGMA * np.random.default_rng(1).normal(size=len(data))
    variance = np.sum(response.poses(data)[data.frame] ** 2, axis=1) + PRIORS.misfit_smooth[0]
    logs = []
    for columns in response.columns(data):
        left_out = float(np.mean(variance - np.sum(columns**2, axis=1)))
        for size in response.scales(data, data.sigma):
            noise = np.eye(len(data)) * (SIGMA**2 + size**2 * left_out)
            logs.append(multivariate_normal(cov=noise + size**2 * columns @ columns.T).logpdf(residual))
    expected = logsumexp(logs) - math.log(len(logs)) + len(data) / 2 * math.log(2 * math.pi)
    found = Evidence.of(errors, residual, no_force(data))
    # Of all discrepancies it is the only one that explains anything here.
    assert found.forced == pytest.approx(
        expected + math.log(PRIORS.response / (PRIORS.force + PRIORS.response)), abs=0.2
    )


def test_smooth_misfit_is_a_discrepancy_and_no_certain_choice_between_hypotheses(
    data: Data, errors: ErrorCovariance
) -> None:
    """Two hypotheses that both miss by far differ by many noises, and yet the data decide little between them."""
    noise = SIGMA * np.random.default_rng(2).normal(size=len(data))
    one, other = (smooth_misfit(data, size * SIGMA) + noise for size in (40.0, 44.0))
    first, second = (Evidence.of(errors, residual, no_force(data)) for residual in (one, other))
    assert first.missing > 0.999
    white = 0.5 * (float(other @ other) - float(one @ one)) / SIGMA**2
    assert white > 5000
    assert abs(first.total - second.total) < white / 500


def test_noise_alone_is_no_discrepancy(data: Data, errors: ErrorCovariance) -> None:
    residual = SIGMA * np.random.default_rng(3).normal(size=len(data))
    assert Evidence.of(errors, residual, no_force(data)).missing < 0.5
