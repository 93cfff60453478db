"""What force is missing, and where, on a slab of cubic elements with a load that its model lacks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI

import bcid
from bcid import Scene, motions
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.parameter import Amount
from bcid.predict.predictor import Predictor
from bcid.scene import Level
from bcid.search.answer.where import MissingForce, SpreadForce, missing_force
from bcid.search.fitting.state import State

SLAB = Path(__file__).resolve().parents[2] / "examples/scenes/slab.toml"
ANCHORS = frozenset({"3", "4"})
# So small that the body bends in proportion to it, to which the force is told.
LOAD = 4000.0
PLACE, WIDTH = np.array([0.065, 0.005, 0.025]), 0.012


def near(point: Point, c: Constants) -> Any:
    """The energy per volume of a load upwards, spread around a place."""
    away = point.X - ufl.as_vector(PLACE.tolist())
    return -c["amount"] * ufl.exp(-0.5 * ufl.inner(away, away) / WIDTH**2) * point.u[1]


def whole() -> float:
    """The volume that the load near a place is worth, m^3."""
    steps = np.stack(np.meshgrid(*(np.linspace(0, size, 101) for size in (0.1, 0.01, 0.1)), indexing="ij"), axis=-1)
    return float(np.exp(-0.5 * np.sum((steps - PLACE) ** 2, axis=-1) / WIDTH**2).mean() * 1e-4)


def missing(hidden: Term) -> MissingForce:
    slab = Scene.read(SLAB, physics=check_physics)
    scene = replace(slab, levels=(Level(2, 0.05), Level(2, 0.02)), noise_sigma=0.2e-3)
    body = replace(scene, levels=(Level(3, 0.025),))
    part = np.array([0.0, 0.5, 1.0])[:, None]
    turned = np.tile([1.0, 0.0, 0.0, 0.0], (len(part), 1))
    pulls = motions.actions([(part * np.array(way), turned) for way in ((0.008, 0.0, 0.0), (0.0, 0.008, 0.0))], "III")
    measured = bcid.simulate(body, sorted(ANCHORS), pulls, noise=0.2e-3, model=Model.of(body) + hidden)
    predictor = Predictor(scene, measured, MPI.COMM_SELF)
    try:
        return missing_force(State.of(predictor, Model.of(scene), ANCHORS))
    finally:
        predictor.destroy()


def assert_summed(force: SpreadForce) -> None:
    assert np.allclose(np.sum([place.force for place in force.regions], axis=0), force.together.force)
    # Parts that stand in for each other are known less well than their sum.
    assert force.together.stderr < np.sqrt(sum(place.stderr**2 for place in force.regions))


def test_a_load_at_a_place_is_missing_there() -> None:
    amount = Amount("amount", "N/m^3", "how much", neutral=0.0, scale=1000.0)
    found = missing(Term(BodyEffect("hidden", (amount,), "hidden", energy=near), {"amount": LOAD}))
    assert found.explained > 0.9
    for force in (found.steady, *found.growing.values()):
        assert_summed(force)
    most = max(found.steady.regions, key=lambda place: place.force[1])
    assert np.linalg.norm(most.position - PLACE) < 0.025
    together = found.steady.together
    total = LOAD * whole()
    assert np.abs(together.force - [0.0, total, 0.0]).max() < 3 * together.stderr
    # That error is mostly of what acts along the slab, which hardly moves it: upwards more is known.
    assert 0.5 * total < together.force[1] < 1.5 * total
