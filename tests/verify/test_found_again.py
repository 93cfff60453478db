"""Terms that remember, or grow with the pull, are named first for a body of cubic elements on which they act."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from mpi4py import MPI

import bcid
from bcid import Scene, motions
from bcid.comparison.predictor import Predictor
from bcid.comparison.state import State
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.parameter import Amount
from bcid.proposal.term_scores import TermScores
from bcid.scene import Level

SLAB = Path(__file__).resolve().parents[2] / "examples/scenes/slab.toml"
ANCHORS = frozenset({"3", "4"})
PLACE, RADIUS = np.array([0.040, 0.0, 0.045]), 0.012


def on_disc(point: Point, value: Any) -> Any:
    """The integral over a round patch with a soft edge, which is no Gaussian."""
    away = point.X - ufl.as_vector(PLACE.tolist())
    inside = (1 - ufl.tanh((ufl.sqrt(ufl.inner(away, away) + 1e-12) - RADIUS) / (0.2 * RADIUS))) / 2
    skin = ufl.Measure("ds", domain=ufl.domain.extract_unique_domain(point.X), metadata={"quadrature_degree": 6})
    return value * inside * skin


def rubbing(point: Point, c: Constants) -> Any:
    """Friction with an edge of another size than that of the grammar."""
    change = point.u - point.past.u
    slid = change - ufl.inner(change, point.N) * point.N
    return on_disc(point, point.past.moving * c["amount"] * ufl.sqrt(ufl.inner(slid, slid) + 3e-4**2))


def swelling(point: Point, c: Constants) -> Any:
    """A pressure in proportion to the way of the gripper."""
    way = ufl.sqrt(ufl.inner(point.gripper, point.gripper) + 1e-20) / 0.1
    normal = point.kin.J * ufl.inv(point.kin.F).T * point.N
    return on_disc(point, c["amount"] * way * ufl.inner(normal, point.v))


def acting(amount: float, **kind: Any) -> Term:
    unit = Amount("amount", "Pa", "how much", neutral=0.0, scale=100.0)
    return Term(BodyEffect("hidden", (unit,), "hidden", acts_on="boundary", **kind), {"amount": amount})


@pytest.mark.parametrize(
    ("families", "hidden"),
    [
        ({"friction_at_a_spot"}, lambda: acting(150.0, potential=rubbing, uses_past=True)),
        # On a small spot a pressure and a traction do the same.
        (
            {"pressure_at_a_spot_with_pull", "traction_at_a_spot_with_pull"},
            lambda: acting(6000.0, work=swelling, symmetric=False),
        ),
    ],
)
def test_what_acts_is_named_first(families: set[str], hidden: Callable[[], Term]) -> None:
    slab = Scene.read(SLAB, physics=check_physics)
    patches = {name: slab.patches[name] for name in ("3", "4", "5")}
    scene = replace(slab, patches=patches, levels=(Level(2, 0.05), Level(2, 0.02)), noise_sigma=0.2e-3)
    body = replace(scene, levels=(Level(3, 0.025),))
    # There and half way back: friction turns round.
    part = np.array([0.0, 0.5, 1.0, 0.7, 0.4])[:, None]
    ways = ((0.014, 0.0, 0.0), (0.006, 0.010, 0.0), (0.004, 0.0, 0.011))
    pulls = motions.actions([(part * np.array(way), np.tile([1.0, 0.0, 0.0, 0.0], (5, 1))) for way in ways], "II")
    measured = bcid.simulate(body, sorted(ANCHORS), pulls, noise=0.2e-3, model=Model.of(body) + hidden())
    predictor = Predictor(scene, measured, MPI.COMM_SELF)
    state = State.of(predictor, Model.of(scene), ANCHORS)
    found = sorted(TermScores(("boundary",)).scored_families(state), key=lambda one: -one.log)
    values = found[0].row.term.values
    assert found[0].family.name in families
    others = [one for one in found if one.family.name not in families | {"friction"}]
    assert others[0].log < found[0].log - 20
    # Of some hundred places the nearest may be so far.
    assert np.linalg.norm([values[f"c{axis}"] for axis in "xyz"] - PLACE) < 0.018
    predictor.destroy()
