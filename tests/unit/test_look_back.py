"""What shows on the way back alone is found, though hypotheses are first compared where a pull turns and where it ends."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from bcid.base.options import ExplainOptions
from bcid.forms.model import Model, Term
from bcid.forms.simulate import simulate
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.scene import Scene
from bcid.search.explain import explain

SOFTENED, STRAIN = 0.5, 0.1


def test_a_body_that_softens_is_told_by_the_forces_of_its_way_back(coarse_scene: Path) -> None:
    scene = Scene.read(coarse_scene)
    model = Model.of(scene) + Term("softening", {"softened": SOFTENED, "strain": STRAIN})
    part = np.array([0, 0.5, 1, 0.7, 0.4, 0])
    still = np.tile([1.0, 0, 0, 0], (6, 1))
    pull = Action("1", np.arange(6), np.arange(6), "II", part[:, None] * np.array([0.012, 0.004, 0]), still)
    true = replace(scene, levels=(replace(scene.levels[0], degree=3),))
    seen = simulate(true, ["3", "4"], [pull], 0, 2e-4, 3, model=model, wrench=True, wrench_noise=2e-3)
    predictor = Predictor(scene, seen, MPI.COMM_SELF)
    found = explain(predictor, ExplainOptions(sets=1, max_effects=1, only=("gravity", "softening")))
    assert found.verdict == "softening"
    predictor.destroy()
