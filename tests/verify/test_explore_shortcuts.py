"""Every shortcut of an exploration leaves pulls, beliefs and the answer as they are: against asking every set for everything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

from bcid.base.options import ExploreOptions
from bcid.exploration import choice, pull_posterior
from bcid.exploration.loop import Exploration, explore
from bcid.exploration.robots import Simulated
from bcid.forms.model import check_physics
from bcid.predict.pull_predictor import PullPredictor
from bcid.predict.store import PredictionStore
from bcid.scene import Level, Scene

PATCHES = ("1", "2", "3", "4", "7")
# Some pulls need more, N.
FORCE = 0.3


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    """The benchmark slab with five of its patches, on coarse meshes."""
    scene = Scene.read(project / "examples" / "scenes" / "slab_explain.toml", physics=check_physics)
    kept = {name: scene.patches[name] for name in PATCHES}
    limits = scene.limits and replace(scene.limits, displacement=6e-3, amplitudes=(6e-3,), force=FORCE)
    return replace(scene, patches=kept, levels=(Level(2, 0.05), Level(2, 0.03)), limits=limits)


def explored(slab: Scene, store: Path, anchors: Sequence[str], noise: float) -> tuple[Exploration, int]:
    """An exploration, and of how many predictions of the working level it knows whether the body may buckle."""
    kept = PredictionStore(store, MPI.COMM_SELF, shared=True)
    levels = [PullPredictor(slab, level, MPI.COMM_SELF, kept) for level in (0, 1)]
    body = PullPredictor(slab, 1, MPI.COMM_SELF, kept)
    robot = Simulated(body, list(anchors), noise, 1)
    found = explore(slab, robot, ExploreOptions(noise=noise, grasps=("III",), budget=3), levels[0], levels[1])
    detailed = sum(known.detailed for known in levels[0]._known.values())
    for predictor in (*levels, body):
        predictor.destroy()
    return found, detailed


def everything(patch: pytest.MonkeyPatch) -> None:
    """Every set is predicted, with force, strain and stability, for every pull that is looked at."""

    def asked(self: Any, option: Any, view: Any, sets: Any, p: Any) -> Any:
        predicted = self.predictor.predict(sets, view.fitted, self._action(option.move), detailed=True)
        return predicted, option.forbidden or self._forbidden(predicted, p)

    patch.setattr(choice.Chooser, "_asked", asked)
    patch.setattr(pull_posterior, "negligible", lambda _: frozenset())


@pytest.mark.parametrize(("anchors", "noise"), [(("1", "2"), 5e-3), (("3", "4"), 1e-3)], ids=["doubtful", "clear"])
def test_an_exploration_ends_as_if_everything_had_been_asked(
    slab: Scene, tmp_path: Path, anchors: Sequence[str], noise: float
) -> None:
    found, few = explored(slab, tmp_path, anchors, noise)
    with pytest.MonkeyPatch.context() as patch:
        everything(patch)
        whole, many = explored(slab, tmp_path, anchors, noise)
    assert found.reason == whole.reason
    assert [step.move for step in found.steps] == [step.move for step in whole.steps]
    assert few < many
    for step, long in zip(found.steps, whole.steps, strict=True):
        assert step.expected[0] == pytest.approx(long.expected[0], abs=0.02)
        for hypothesis, p in long.view.probabilities.items():
            assert step.view.probabilities.get(hypothesis, 0.0) == pytest.approx(p, abs=5e-3)
        barred = [{o.move for o in one.options if o.forbidden} for one in (step, long)]
        assert barred[0] == barred[1]
