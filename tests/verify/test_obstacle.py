"""Balls that are tried in the way of the body, and one that it really meets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from bcid.forms import effects
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.simulate import simulate
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.mesh_error import MeshError
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.scene import Level, Scene
from bcid.search.fitting.ahead import obstacle_candidates
from bcid.search.fitting.ranking import rank
from bcid.search.fitting.state import State

ANCHORS, STEPS = frozenset("34"), 5
# Above the slab, 2 mm from its top.
BALL = {"stiffness": 5e5, "cx": 0.06, "cy": 0.042, "cz": 0.05, "radius": 0.03}


def test_a_ball_above_a_slab_that_is_lifted_is_found(project: Path) -> None:
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    scene = replace(scene, levels=(Level(2, 0.05),), noise_sigma=0.1e-3)
    part = np.arange(STEPS)[:, None] / (STEPS - 1)
    unturned, steps = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1)), np.arange(STEPS)
    ways = {"II": (0.0, 8e-3, 0.0), "I": (5e-3, 0.0, 0.0)}
    pulls = [
        Action(str(k), k * STEPS + steps, steps, grasp, part * np.array(way), unturned)
        for k, (grasp, way) in enumerate(ways.items())
    ]
    plain = Model.of(scene)
    seen = simulate(scene, ANCHORS, pulls, level=0, noise=0.0, model=plain + Term("obstacle", BALL))
    predictor = Predictor(scene, seen, MPI.COMM_SELF, settings=Settings(rtol=1e-8))
    state = State.of(predictor, plain, ANCHORS, MeshError.unknown(predictor.data.mask.shape))
    points = predictor.forward(plain).mesh.points
    tried = obstacle_candidates(state)
    assert len(tried) > 10
    for ball in tried:
        centre = np.array([ball["cx"], ball["cy"], ball["cz"]])
        assert np.linalg.norm(points - centre, axis=1).min() > ball["radius"], "clear of the body at rest"
    ranking = rank(state, [effects.effect(name) for name in ("obstacle", "gravity", "prestrain")], strict=False)
    assert ranking.rows[0].effect == "obstacle"
    found = ranking.rows[0].term.values
    assert found["cy"] > 0.02
    assert found["stiffness"] > 0
    assert ranking.rows[0].score > 0.5 * state.chi2
    predictor.destroy()
