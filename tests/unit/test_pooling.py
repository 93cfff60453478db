"""Dense fields: groups of neighbours in place of points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid.comparison.predictor import Predictor
from bcid.comparison.ranking import rank
from bcid.comparison.state import State
from bcid.forms import effects
from bcid.forms.model import Model, check_physics
from bcid.forms.simulate import simulate
from bcid.measurement import Measurement
from bcid.measurement.pooling import Pooled, pooled
from bcid.scene import Level, Scene, motions
from bcid.search.identify_run import fitting

NOISE = 0.2e-3


@pytest.fixture(scope="module")
def dense(project: Path) -> Scene:
    """A slab with 30 x 20 points on its upper side."""
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    places = [(x, 0.01, z) for x in np.linspace(0.004, 0.096, 30) for z in np.linspace(0.004, 0.096, 20)]
    points = {str(k + 1): tuple(map(float, place)) for k, place in enumerate(places)}
    return replace(scene, levels=(Level(2, 0.03),), fiducials=points)


@pytest.fixture(scope="module")
def seen(dense: Scene) -> Measurement:
    return simulate(dense, ["3", "4"], motions.motion("pull", "II", 1, 0.01, 4), noise=0.0)


@pytest.fixture(scope="module")
def groups(dense: Scene, seen: Measurement) -> Pooled:
    found = pooled(dense, seen)
    assert found is not None
    return found


def test_every_point_is_in_one_group_of_neighbours(dense: Scene, groups: Pooled) -> None:
    members = [name for group in groups.groups.values() for name in group]
    assert sorted(members, key=int) == dense.fiducial_names
    assert len(groups.groups) == 128
    sizes = {len(group) for group in groups.groups.values()}
    assert sizes == {4, 5}
    for names in groups.groups.values():
        places = np.array([dense.fiducials[name] for name in names])
        assert np.ptp(places, axis=0).max() < 0.016
    assert next(iter(groups.groups)) == "1+3"


def test_the_mean_of_points_is_predicted_as_it_is_seen(groups: Pooled) -> None:
    """Also where the displacement has a kink, as at the border of the grasp."""
    again = simulate(groups.scene, ["3", "4"], motions.motion("pull", "II", 1, 0.01, 4), noise=0.0)
    assert again.positions == pytest.approx(groups.measurement.positions, abs=1e-12)


def test_noise_is_that_of_the_mean(dense: Scene, seen: Measurement) -> None:
    rng = np.random.default_rng(0)
    data = seen.data.copy(deep=True)
    data["position"] += rng.normal(0.0, NOISE, data["position"].shape)
    found, clean = pooled(dense, replace(seen, data=data, noise_sigma=NOISE)), pooled(dense, seen)
    assert found is not None
    assert clean is not None
    sigma = found.measurement.sigma()
    assert sigma is not None
    apart = (found.measurement.positions - clean.measurement.positions) / sigma
    assert float(np.sqrt(np.mean(apart**2))) == pytest.approx(1.0, abs=0.05)


def test_points_that_are_not_seen_do_not_count(dense: Scene, seen: Measurement, groups: Pooled) -> None:
    name, members = next(iter(groups.groups.items()))
    data = seen.data.copy(deep=True)
    hidden = [seen.fiducial_names.index(one) for one in members[:1]]
    data["position"][{"frame": [2], "fiducial": hidden}] = np.nan
    data["position"][{"frame": [3], "fiducial": [seen.fiducial_names.index(one) for one in members[:3]]}] = np.nan
    found = pooled(dense, replace(seen, data=data, noise_sigma=NOISE))
    assert found is not None
    column = found.measurement.fiducial_names.index(name)
    near = found.measurement.positions[2, column] - groups.measurement.positions[2, column]
    assert np.abs(near).max() < 1e-3
    assert np.isnan(found.measurement.positions[3, column]).all()
    sigma = found.measurement.sigma()
    assert sigma is not None
    assert sigma[2, column] == pytest.approx(np.full(3, NOISE / np.sqrt(len(members) - 1)))


def test_few_points_stay_as_they_are(project: Path) -> None:
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    measurement = Measurement.read(project / "examples" / "measurements" / "slab-34-complex")
    assert pooled(scene, measurement) is None
    same, kept = fitting(scene, measurement, MPI.COMM_SELF)
    assert same.fiducials == scene.fiducials
    assert not same.members
    assert kept.fingerprint() == measurement.fingerprint()


def test_no_mean_is_a_marker_that_is_wrong(groups: Pooled) -> None:
    predictor = Predictor(groups.scene, replace(groups.measurement, noise_sigma=NOISE), MPI.COMM_SELF)
    state = State.of(predictor, Model.of(groups.scene), frozenset("34"))
    found = rank(state, [effects.effect("marker_fault"), effects.effect("gravity")])
    assert "dense field" in found.excluded["marker_fault"]
    predictor.destroy()
