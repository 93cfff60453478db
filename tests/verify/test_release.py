"""A patch that comes off: before it all anchors are seen, after it the others, in predictions and in what is made of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from bcid.forms import effects
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.probes import Probe, SensitivityRequest
from bcid.forms.simulate import simulate
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.mesh_error import MeshError
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.scene import Level, Scene
from bcid.search.fitting.fit import fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis, promoted
from bcid.search.fitting.loosened import loosened
from bcid.search.fitting.state import State
from bcid.search.fitting.variants import all_variants

Array = NDArray[np.float64]
BOTH, LEFT = frozenset("34"), frozenset("3")
STEPS, ONSET = 4, 6


@pytest.fixture(scope="module")
def predictor(project: Path) -> Iterator[Predictor]:
    """Two pulls of 5 mm; in the middle of the second patch 4 comes off."""
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    scene = replace(scene, levels=(Level(2, 0.05),), noise_sigma=0.2e-3)
    unturned, steps = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1)), np.arange(STEPS)
    ways = {"I": (1, 0, 0), "II": (0, 1, 0.5)}
    pulls = [
        Action(str(k), k * STEPS + steps, steps, grasp, 5e-3 / (STEPS - 1) * steps[:, None] * np.array(way), unturned)
        for k, (grasp, way) in enumerate(ways.items())
    ]
    seen = simulate(scene, BOTH, pulls, level=0, noise=0.0, model=model(scene), wrench=True)
    predictor = Predictor(scene, seen, MPI.COMM_SELF, settings=Settings(rtol=1e-10))
    yield predictor
    predictor.destroy()


def model(scene: Scene) -> Model:
    return Model.of(scene) + Term("release", {"released": 1.0, "onset": ONSET}, place="4")


def pieced(before: Array, after: Array) -> Array:
    return np.concatenate([before[:ONSET], after[ONSET:]])


def test_what_is_seen_is_pieced_together(predictor: Predictor) -> None:
    plain, loose = Model.of(predictor.scene), model(predictor.scene)
    both, left = (predictor.predict(plain, s, keep=True) for s in (BOTH, LEFT))
    found = predictor.predict(loose, BOTH, keep=True)
    np.testing.assert_allclose(found.positions, pieced(both.positions, left.positions), atol=1e-9)
    weight = Probe(Term("gravity", {"weight": 0.0}), ("weight",))
    slopes = [
        predictor.sensitivities(m, s, p, SensitivityRequest((weight,))).probes[0]["weight"]
        for m, s, p in ((plain, BOTH, both), (plain, LEFT, left), (loose, BOTH, found))
    ]
    expected = pieced(*slopes[:2])
    # At a few steps of a smooth model only; those of the other are computed.
    np.testing.assert_allclose(slopes[2], expected, atol=0.02 * np.abs(expected).max())


def test_of_other_sets_only_that_of_the_held_patches_counts(predictor: Predictor) -> None:
    plain, loose = Model.of(predictor.scene), model(predictor.scene)
    about = predictor.set_tangent(loose, BOTH, predictor.predict(loose, BOTH, keep=True))
    moved = about.moved(LEFT)
    assert not moved[ONSET:].any()
    same = predictor.set_tangent(plain, BOTH, predictor.predict(plain, BOTH, keep=True))
    frames = sorted(f for f in set(same.steps) & set(about.steps) if f < ONSET)
    np.testing.assert_allclose(moved[frames], same.moved(LEFT)[frames], atol=1e-9)
    assert np.abs(moved[frames]).max() > 1e-4


def test_frames_keep_their_numbers_where_few_are_looked_at(predictor: Predictor) -> None:
    loose = model(predictor.scene)
    whole = predictor.predict(loose, BOTH)
    few, frames = predictor.thinned(2, predictor.settings)
    assert len(frames) < 2 * STEPS
    np.testing.assert_allclose(few.predict(loose, BOTH).positions, whole.positions[frames], atol=1e-8)


def test_patch_and_frame_are_found_in_all_steps(predictor: Predictor) -> None:
    """Of all patches and frames that fits best which is true, and it leaves nothing: a tangent would."""
    nothing = MeshError.unknown(predictor.data.mask.shape)
    state = State.of(predictor, Model.of(predictor.scene), BOTH, nothing)
    release = effects.effect("release")
    variants = all_variants(state, [(release, patch) for patch in sorted(BOTH)])["release"]
    assert len(variants) == 2 * 2 * STEPS
    left = [np.sum((state.scaled - v.sensitivity[:, 0]) ** 2) for v in variants]
    best = variants[int(np.argmin(left))].term
    assert (best.place, best.values["onset"]) == ("4", ONSET)
    assert min(left) < 1e-9 * state.chi2


def test_set_patch_and_frame_are_found_about_another_set(predictor: Predictor) -> None:
    """Of all sets, their patches and all frames, as the tangent of one that neither was held shows them."""
    nothing = MeshError.unknown(predictor.data.mask.shape)
    state = State.of(predictor, Model.of(predictor.scene), frozenset("38"), nothing)
    sets = [frozenset(s) for count in (1, 2, 3) for s in combinations(sorted(predictor.scene.patches), count)]
    best = loosened(state, effects.effect("release"), sets, ())[0]
    assert (best.anchors, best.term.place, best.term.values["onset"]) == (BOTH, "4", ONSET)
    assert best.chi2 < 0.1 * state.chi2
    followed = state.of_set(BOTH, Model.of(predictor.scene) + best.term)
    assert followed.chi2 < 0.1 * best.chi2


def test_what_acts_besides_is_fitted_with_it(predictor: Predictor) -> None:
    """A release that is placed anew in all steps leaves the numbers of the other effects free."""
    plain, nothing = Model.of(predictor.scene), MeshError.unknown(predictor.data.mask.shape)
    heavy = plain + Term("gravity", {"weight": 10.0})
    loose = State.of(predictor, heavy + model(predictor.scene).terms[-1], BOTH, nothing)
    rival = FittedHypothesis.of(fit(loose, ("gravity.weight",)), plain, 2)
    found = promoted(rival, State.of(predictor, plain, BOTH, nothing), plain)
    assert found is not None
    assert found.names == ("gravity", "release")
    assert set(found.fitted.stderr) == {"gravity.weight"}


def test_a_gripper_feels_what_is_left(predictor: Predictor) -> None:
    loose, plain = model(predictor.scene), Model.of(predictor.scene)
    wrenches = []
    for parts, anchors in ((loose, BOTH), (plain, BOTH), (plain, LEFT)):
        forward = predictor.forward(parts)
        found = forward.predict(anchors, predictor.actions, keep=True)
        wrenches.append(forward.detail(anchors, predictor.actions, found).wrench)
    np.testing.assert_allclose(wrenches[0], pieced(wrenches[1], wrenches[2]), atol=1e-7)
