"""Small steps of the gripper with any set of anchors, from one factorisation, against sets that are followed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid.forms.model import check_physics
from bcid.predict.pull_predictor import PullPredictor, small_action
from bcid.scene import Level, Scene

SETS = [frozenset(names) for names in ("", "1", "34", "1278", "12345678")]


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    scene = Scene.read(project / "examples" / "scenes" / "slab_explain.toml", physics=check_physics)
    return replace(scene, levels=(Level(2, 0.05),))


@pytest.mark.parametrize("grasp", ["I", "II"])
def test_small_steps_are_those_of_the_sets_to_first_order(slab: Scene, grasp: str) -> None:
    """What is left out falls with the step."""
    predictor = PullPredictor(slab, 0, MPI.COMM_SELF)
    apart = []
    for size in (1e-4, 1e-5):
        told = predictor.small_steps(SETS, grasp, size)
        followed = predictor.predict([(anchors, small_action(grasp, size)) for anchors in SETS])
        apart.append(max(np.abs(a.positions - b.positions).max() for a, b in zip(told, followed, strict=True)) / size)
    assert apart[0] < 5e-3
    assert apart[1] == pytest.approx(apart[0] / 10, rel=0.2)
    predictor.destroy()


def test_a_body_that_is_loaded_at_rest_is_followed(slab: Scene) -> None:
    heavy = PullPredictor(replace(slab, effects={"gravity": {"weight": "2000 N/m^3"}}), 0, MPI.COMM_SELF)
    told = heavy.small_steps(SETS[1:3], "I", 1e-4)
    followed = heavy.predict([(anchors, small_action("I", 1e-4)) for anchors in SETS[1:3]])
    assert [a.positions.tolist() for a in told] == [b.positions.tolist() for b in followed]
    assert heavy.evaluations == 2
    heavy.destroy()
