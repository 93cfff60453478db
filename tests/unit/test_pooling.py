"""Dense fields: groups of neighbours in place of points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid.forms import effects
from bcid.forms.model import Model, check_physics
from bcid.forms.simulate import simulate
from bcid.measurement import Measurement
from bcid.measurement.compared import pooled
from bcid.predict.predictor import Predictor
from bcid.scene import Level, Scene, motions
from bcid.search.answer.source import fitting
from bcid.search.fitting.ranking import rank
from bcid.search.fitting.state import State

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
def groups(dense: Scene, seen: Measurement) -> tuple[Scene, Measurement]:
    return pooled(dense, seen)


def test_every_point_is_in_one_group_of_neighbours(dense: Scene, groups: tuple[Scene, Measurement]) -> None:
    members = groups[0].members
    assert sorted(place for group in members.values() for place in group) == sorted(dense.fiducials.values())
    assert len(members) == 128
    assert {len(group) for group in members.values()} == {4, 5}
    assert max(np.ptp(np.array(group), axis=0).max() for group in members.values()) < 0.016
    assert next(iter(members)) == "1+3"


def test_the_mean_of_points_is_predicted_as_it_is_seen(groups: tuple[Scene, Measurement]) -> None:
    """Also where the displacement has a kink, as at the border of the grasp."""
    again = simulate(groups[0], ["3", "4"], motions.motion("pull", "II", 1, 0.01, 4), noise=0.0)
    assert again.positions == pytest.approx(groups[1].positions, abs=1e-12)


def test_noise_is_that_of_the_mean(dense: Scene, seen: Measurement) -> None:
    rng = np.random.default_rng(0)
    data = seen.data.copy(deep=True)
    data["position"] += rng.normal(0.0, NOISE, data["position"].shape)
    (_, found), (_, clean) = pooled(dense, replace(seen, data=data, noise_sigma=NOISE)), pooled(dense, seen)
    sigma = found.sigma()
    assert sigma is not None
    apart = (found.positions - clean.positions) / sigma
    assert float(np.sqrt(np.mean(apart**2))) == pytest.approx(1.0, abs=0.05)


def test_points_that_are_not_seen_do_not_count(
    dense: Scene, seen: Measurement, groups: tuple[Scene, Measurement]
) -> None:
    scene, clean = groups
    name, places = next(iter(scene.members.items()))
    numbers = [list(dense.fiducials.values()).index(place) for place in places]
    data = seen.data.copy(deep=True)
    data["position"][{"frame": [2], "fiducial": numbers[:1]}] = np.nan
    data["position"][{"frame": [3], "fiducial": numbers[:3]}] = np.nan
    _, found = pooled(dense, replace(seen, data=data, noise_sigma=NOISE))
    column = found.fiducial_names.index(name)
    assert np.abs(found.positions[2, column] - clean.positions[2, column]).max() < 1e-3
    assert np.isnan(found.positions[3, column]).all()
    sigma = found.sigma()
    assert sigma is not None
    assert sigma[2, column] == pytest.approx(np.full(3, NOISE / np.sqrt(len(places) - 1)))


def test_few_points_stay_as_they_are(project: Path) -> None:
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    measurement = Measurement.read(project / "examples" / "measurements" / "slab-34-complex")
    assert pooled(scene, measurement) == (scene, measurement)
    same, kept = fitting(scene, measurement, MPI.COMM_SELF)
    assert same.fiducials == scene.fiducials
    assert not same.members
    assert kept.fingerprint() == measurement.fingerprint()


def test_no_mean_is_a_marker_that_is_wrong(groups: tuple[Scene, Measurement]) -> None:
    predictor = Predictor(groups[0], replace(groups[1], noise_sigma=NOISE), MPI.COMM_SELF)
    state = State.of(predictor, Model.of(groups[0]), frozenset("34"))
    found = rank(state, [effects.effect("marker_fault"), effects.effect("gravity")])
    assert "dense field" in found.excluded["marker_fault"]
    predictor.destroy()
