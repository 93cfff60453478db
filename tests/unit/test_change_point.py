"""Something that begins at a spot: its evidence, and that it is told from noise and from what is there all the time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bcid.inference.change_point import ChangePointForce
from bcid.inference.data import Data
from bcid.inference.discrepancy import Evidence, SmoothDiscrepancy
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.evidence import LinearParameters
from bcid.inference.mesh_error import MeshError
from bcid.inference.priors import PRIORS, spaced
from tests.unit.test_missing_force_evidence import SCENE, STEPS, UNIT, errors, measurement, slopes

PLACES = 3
MOST = 2e-3


def spots(data: Data) -> np.ndarray:
    """Movements per unit of a force at each of some places: of all markers, the nearest most."""
    near = np.exp(-np.abs(data.fiducial[:, None] - np.arange(PLACES)[None]))
    return np.asarray(near[:, :, None] * (data.axis[:, None, None] == np.arange(3)))


def residual(data: Data) -> np.ndarray:
    return data.values - data.vector(np.tile(SCENE.rest, (2 * STEPS, 1, 1)))


def everything(known: ErrorCovariance, data: Data) -> list[tuple[int, int, np.ndarray]]:
    """First frame, place and columns of all that may begin."""
    slopes, found = spots(data), []
    for course in (np.ones(len(data)), data.way):
        for span in ("action", "measurement"):
            for frame in range(2 * STEPS):
                action, step = divmod(frame, STEPS)
                last = STEPS - 1 if span == "action" else 2 * STEPS - 1
                if step < 2 or (step if span == "action" else frame) == last:
                    continue
                acts = (data.frame >= frame) & ((data.action == action) | (span == "measurement"))
                found += [(frame, place, (acts * course)[:, None] * slopes[:, place]) for place in range(PLACES)]
    return found


def test_its_evidence_is_that_of_a_gaussian_averaged_over_all_that_may_begin() -> None:
    data = Data(SCENE, measurement())
    rng = np.random.default_rng(3)
    mesh = MeshError(np.zeros(data.mask.shape), 2e-4 * rng.normal(size=data.mask.shape), True)
    known = ErrorCovariance(data, data.sigma, mesh, errors(data).nuisances)
    columns = 3e-4 * rng.normal(size=(len(data), 2))
    widths = np.array([[0.5, 1.0], [1.0, 2.0], [3.0, 5.0]])
    numbers = LinearParameters(known.whiten(columns), np.array([0.3, -0.2]), widths, np.zeros(2, bool))
    found = ChangePointForce(known, spots(data)).beginning(residual(data), numbers)
    unit = np.column_stack([known.unwhiten(one) for one in np.eye(len(data))])
    base = unit @ unit.T + (columns * widths[1]) @ (columns * widths[1]).T
    seen = residual(data) + columns @ numbers.apart
    smooth = []
    for place in range(PLACES):
        columns = np.hstack([data.way[:, None] ** power * spots(data)[:, place] for power in range(3)])
        columns = columns / np.linalg.norm(known.whiten(columns), axis=0)
        smooth.append(PRIORS.sudden_sizes[1] ** 2 * columns @ columns.T)
    gains = []
    for _, place, moved in everything(known, data):
        before = multivariate_normal(cov=base + smooth[place])
        # What is smooth is taken out of it as it is out of all else, but for what is unknown besides.
        covariance = unit @ unit.T + smooth[place]
        size = np.sqrt(np.trace(moved.T @ np.linalg.solve(covariance, moved)) / 3)
        if size**2 < 1e-6 * np.sum(known.whiten(moved) ** 2) / 3:
            continue
        shown = (moved / size) @ (moved / size).T
        each = [multivariate_normal(cov=before.cov + s**2 * shown).logpdf(seen) for s in spaced(PRIORS.sudden_sizes)]
        gains.append(logsumexp(each) - np.log(len(each)) - before.logpdf(seen))
    assert found is not None
    assert found.log == pytest.approx(logsumexp(gains) - np.log(len(gains)), rel=1e-6)


@pytest.mark.parametrize("until", ["action", "measurement"])
def test_when_it_begins_is_told(until: str) -> None:
    data = Data(SCENE, measurement())
    known, begins = errors(data), 3
    acts = (data.frame >= begins) & ((data.action == 0) | (until == "measurement"))
    pushed = residual(data) + MOST * acts * spots(data)[:, 1, 2]
    found = ChangePointForce(known, spots(data)).beginning(pushed, LinearParameters.none(len(data)))
    assert found is not None
    assert found.by == begins
    assert found.log > 10


def test_noise_does_not_begin() -> None:
    logs = []
    for seed in range(5):
        data = Data(SCENE, measurement(seed=seed))
        found = ChangePointForce(errors(data), spots(data)).beginning(residual(data), LinearParameters.none(len(data)))
        assert found is not None
        logs.append(found.log)
    assert max(logs) < 0


def test_nothing_begins_where_no_motion_was_seen_before() -> None:
    seen = np.full((2 * STEPS, len(SCENE.rest), 3), np.nan)
    seen[::STEPS], seen[1::STEPS] = SCENE.rest, SCENE.rest
    data = Data(SCENE, measurement(seen))
    assert (
        ChangePointForce(errors(data), spots(data)).beginning(0 * data.values, LinearParameters.none(len(data))) is None
    )


def test_evidence_smooth_or_sudden_discrepancy_each_has_its_prior() -> None:
    data = Data(SCENE, measurement())
    known, acts = errors(data), data.frame >= 3
    pushed = residual(data) + 0.05 * MOST * acts * spots(data)[:, 1, 2]
    forces = SmoothDiscrepancy((slopes(data),)).forces(known, UNIT)
    without = Evidence.of(known, pushed, forces)
    found = Evidence.of(known, pushed, forces, sudden=ChangePointForce(known, spots(data)))
    assert found.begins is not None
    # Each kind of discrepancy has its prior.
    others = (PRIORS.force + PRIORS.response) / PRIORS.discrepancy * np.exp(without.forced - found.plain)
    begins = PRIORS.change_point / PRIORS.discrepancy * np.exp(found.begins.log)
    whole = others + begins
    assert found.forced - found.plain == pytest.approx(np.log(whole))
    assert found.sudden == pytest.approx(begins / whole)
    assert 0.01 < found.sudden < 0.99
    assert found.plain == without.plain
    assert without.sudden == 0
