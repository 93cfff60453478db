"""The evidence of an unknown force, of what grows, and of a misfit in observation space."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bcid.forms import effect_trial as trial
from bcid.forms.simulate import recorded
from bcid.inference import response
from bcid.inference.data import Data
from bcid.inference.discrepancy import Evidence, EvidenceCells, SmoothDiscrepancy, courses, low_rank_discrepancy
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.evidence import LinearParameters
from bcid.inference.mesh_error import MeshError
from bcid.inference.nuisances import NuisanceModes
from bcid.inference.priors import PRIORS, spaced
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Action, Measurement

Array = NDArray[np.float64]
SCENE = trial.scene()
SIGMA = 0.2e-3
STEPS = 6
TRUE = frozenset("2")
UNIT = 1e3


def measurement(positions: Array | None = None, seed: int = 0) -> Measurement:
    """Two pulls in which the markers rest, seen with noise."""
    number = np.arange(STEPS)
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1))
    way = 1e-3 * number[:, None] * np.array([[1.0, 0.0, 0.0]])
    pulls = [Action(str(i + 1), i * STEPS + number, number, "gripper", way, turns) for i in range(2)]
    seen = np.tile(SCENE.rest, (2 * STEPS, 1, 1)) if positions is None else positions
    return recorded(SCENE, pulls, seen, SIGMA, np.random.default_rng(seed))


def slopes(data: Data) -> Array:
    """Movements per unit of three forces, which grow along an action."""
    return 1e-6 * data.progress[:, None] * np.random.default_rng(4).normal(size=(12, 3))[data.fiducial * 3 + data.axis]


def errors(data: Data) -> ErrorCovariance:
    common = 0.3e-3 * np.random.default_rng(6).normal(size=(len(data), 2))
    modes = NuisanceModes(np.zeros((len(data), 3)), common, ("grip", "grip"), {"grip": 0.3e-3})
    return ErrorCovariance(data, data.sigma, MeshError.unknown(data.mask.shape), modes)


# -- the evidence
# ------------------------------------------------------------------------------------------------------------------


def test_the_evidence_is_that_of_a_gaussian_averaged_over_sizes() -> None:
    data = Data(SCENE, measurement())
    known, moved = errors(data), courses(data, slopes(data))
    # Both pulls are alike.
    assert moved.shape == (len(data), 3 * 2)
    residual = data.values - data.vector(np.tile(SCENE.rest, (2 * STEPS, 1, 1)))
    force = low_rank_discrepancy(known, moved, UNIT)
    found = Evidence.of(known, residual, [force])
    base = np.diag(data.sigma**2) + known.nuisances.common @ known.nuisances.common.T
    constant = len(data) / 2 * math.log(2 * math.pi)
    assert found.plain == pytest.approx(multivariate_normal(cov=base).logpdf(residual) + constant, rel=1e-9)
    # A force that hardly moves a marker is none.
    shown = np.sqrt(np.mean(np.sum(moved**2, axis=1) / data.sigma**2))
    assert force.sizes == pytest.approx(
        [UNIT * size for size in spaced(PRIORS.force_sizes) if UNIT * size * shown >= THRESHOLDS.effect]
    )
    assert 0 < len(force.sizes) < len(spaced(PRIORS.force_sizes))
    covariances = [base + size**2 * moved @ moved.T for size in force.sizes]
    each = [multivariate_normal(cov=c).logpdf(residual) + constant for c in covariances]
    assert found.size == pytest.approx(force.sizes[int(np.argmax(each))])
    # Or it is a misfit in observation space, whose variance beyond its columns makes all errors larger.
    misfits = []
    variance = np.sum(response.poses(data) ** 2, axis=1)[data.frame] + PRIORS.misfit_smooth[0]
    for columns in response.columns(data):
        left_out = max(float(np.mean((variance - np.sum(columns**2, axis=1)) / data.sigma**2)), 0.0)
        for size in response.scales(data, data.sigma):
            covariance = (1 + left_out * size**2) * base + size**2 * columns @ columns.T
            misfits.append(multivariate_normal(cov=covariance).logpdf(residual) + constant)
    expected = [logsumexp(logs) - math.log(len(logs)) for logs in (each, misfits)]
    priors = np.array([PRIORS.force, PRIORS.response]) / (PRIORS.force + PRIORS.response)
    assert found.forced == pytest.approx(logsumexp(expected, b=priors), rel=1e-9)
    assert found.total == pytest.approx(
        np.logaddexp(found.plain + math.log(1 - PRIORS.missing), found.forced + math.log(PRIORS.missing))
    )


@pytest.mark.parametrize(("pushed", "missing"), [(0.0, False), (3e3, True)])
def test_what_a_force_does_is_missed_and_noise_is_not(pushed: float, missing: bool) -> None:
    data = Data(SCENE, measurement())
    residual = data.values - data.vector(np.tile(SCENE.rest, (2 * STEPS, 1, 1)))
    known = errors(data)
    forces = SmoothDiscrepancy((slopes(data),)).forces(known, UNIT)
    found = Evidence.of(known, residual + pushed * slopes(data)[:, 1], forces)
    assert (found.missing > 0.95) == missing
    assert missing or found.missing < 0.5


def test_cells_add_up_to_the_evidence_and_change_one_by_one() -> None:
    data = Data(SCENE, measurement())
    known = errors(data)
    residual = data.values - data.vector(np.tile(SCENE.rest, (2 * STEPS, 1, 1))) + 1e3 * slopes(data)[:, 1]
    forces, nothing = SmoothDiscrepancy((slopes(data),)).forces(known, UNIT), LinearParameters.none(len(data))
    cells, other = (EvidenceCells.of(known, one, forces, known.misfits, nothing) for one in (residual, 1.1 * residual))
    found, whole = cells.evidence(known.log_volume), Evidence.of(known, residual, forces)
    assert (found.plain, found.forced) == pytest.approx((whole.plain, whole.forced))
    changed = cells.beside(other, cells).evidence(known.log_volume)
    expected = Evidence.of(known, 1.1 * residual, forces)
    assert (changed.plain, changed.forced) == pytest.approx((expected.plain, expected.forced))


def test_a_force_and_a_growth_count_alike_and_the_likelier_is_told() -> None:
    data = Data(SCENE, measurement())
    known, one = errors(data), slopes(data)
    other = one[np.random.default_rng(8).permutation(len(data))]
    both = SmoothDiscrepancy((one, other))
    residual = data.values - data.vector(np.tile(SCENE.rest, (2 * STEPS, 1, 1))) + 3e3 * other[:, 1]
    found = Evidence.of(known, residual, both.forces(known, UNIT))
    alone = [Evidence.of(known, residual, SmoothDiscrepancy((kind,)).forces(known, UNIT)) for kind in both.kinds]
    assert found.forced == pytest.approx(np.logaddexp(*(each.forced for each in alone)) - math.log(2), abs=1e-6)
    assert (found.kind, found.size) == (1, alone[1].size)
    assert both.likeliest(data, found) == pytest.approx(found.size * courses(data, other))
    assert alone[1].forced > alone[0].forced + 10


def test_an_unknown_force_may_grow_from_the_first_frame_to_the_last() -> None:
    """What dries or swells goes on between actions; where all begin at the same time nothing is known of that."""
    seen = measurement()
    clocks = np.concatenate([number * 30.0 + np.arange(STEPS) for number in range(2)])
    later = replace(seen, data=seen.data.assign(time=("frame", clocks)))
    data = Data(SCENE, later)
    assert data.late == pytest.approx(clocks[data.frame] / clocks[-1])
    moved, steady = courses(data, slopes(data)), slopes(data)
    assert moved.shape == (len(data), 3 * 3)
    drift = data.late[:, None] * steady
    assert np.linalg.lstsq(moved, drift, rcond=None)[0].shape == (9, 3)
    assert moved @ np.linalg.lstsq(moved, drift, rcond=None)[0] == pytest.approx(drift, abs=1e-12)
    alone = data.within(np.arange(2 * STEPS) >= STEPS)
    assert alone.late.min() == pytest.approx(30.0 / clocks[-1])
    again = replace(seen, data=seen.data.assign(time=("frame", np.tile(np.arange(float(STEPS)), 2))))
    assert not Data(SCENE, again).late.any()


def test_both_levels_tell_the_same_limit() -> None:
    coarse, fine = np.random.default_rng(2).normal(size=(2, 4, 3, 3))
    below, here = MeshError.between(coarse, fine, 3.0), MeshError.beyond(coarse, fine, 3.0)
    assert coarse + below.correction == pytest.approx(fine + here.correction)
    assert below.left == pytest.approx(here.left)


def test_some_frames_alone() -> None:
    data = Data(SCENE, measurement())
    frames = np.arange(2 * STEPS) < 4
    part = data.within(frames)
    rows = frames[data.frame]
    assert part.values == pytest.approx(data.values[rows])
    assert (part.fiducial == data.fiducial[rows]).all()
    assert part.progress.max() == 1.0
    assert len(data) == 2 * STEPS * 12
