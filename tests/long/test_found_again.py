"""What acts on a body of cubic elements is found.

Terms that remember, or grow with the pull, are named first; what holds a piece of a patch is told from the patch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from mpi4py import MPI
from numpy.typing import NDArray

import bcid
from bcid import Scene, motions
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.parameter import Amount
from bcid.grammar.term_scores import TermScores
from bcid.predict.predictor import Predictor
from bcid.scene import Level
from bcid.search.coarse_search import CoarseSearch
from bcid.search.fitting.state import State, in_few_steps

SLAB = Path(__file__).resolve().parents[2] / "examples/scenes/slab.toml"
ANCHORS = frozenset({"3", "4"})
NOISE = 0.2e-3
HELD = np.array([0.045, 0.005, 0.1])
PLACE, RADIUS = np.array([0.040, 0.0, 0.045]), 0.012


def on_disc(point: Point, value: Any, place: NDArray[np.float64] = PLACE) -> Any:
    """The integral over a round patch with a soft edge, which is no Gaussian."""
    away = point.X - ufl.as_vector(place.tolist())
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


def stopped(point: Point, c: Constants) -> Any:
    """A piece of patch 2 cannot move outwards."""
    return on_disc(point, c["amount"] / 2 * ufl.max_value(ufl.inner(point.u, point.N), 0.0) ** 2, HELD)


def acting(amount: float, **kind: Any) -> Term:
    unit = Amount("amount", "Pa", "how much", neutral=0.0, scale=100.0)
    return Term(BodyEffect("hidden", (unit,), "hidden", acts_on="boundary", **kind), {"amount": amount})


def pulled(patches: Sequence[str], anchors: frozenset[str], hidden: Term, parts: Sequence[float]) -> Predictor:
    """A slab with some patches, on which something acts that its scene does not know of, pulled in three directions."""
    slab = Scene.read(SLAB, physics=check_physics)
    named = {name: slab.patches[name] for name in patches}
    scene = replace(slab, patches=named, levels=(Level(2, 0.05), Level(2, 0.02)), noise_sigma=NOISE)
    body = replace(scene, levels=(Level(3, 0.025),))
    part = np.array([0.0, *parts])[:, None]
    ways = ((0.014, 0.0, 0.0), (0.006, 0.010, 0.0), (0.004, 0.0, 0.011))
    turned = np.tile([1.0, 0.0, 0.0, 0.0], (len(part), 1))
    pulls = motions.actions([(part * np.array(way), turned) for way in ways], "II")
    measured = bcid.simulate(body, sorted(anchors), pulls, noise=NOISE, model=Model.of(body) + hidden)
    return Predictor(scene, measured, MPI.COMM_SELF)


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
    # There and half way back: friction turns round.
    predictor = pulled(("3", "4", "5"), ANCHORS, hidden(), (0.5, 1.0, 0.7, 0.4))
    state = State.of(predictor, Model.of(predictor.scene), ANCHORS)
    found = sorted(TermScores(("boundary",)).scored_families(state), key=lambda one: -one.log)
    values = found[0].row.term.values
    assert found[0].family.name in families
    others = [one for one in found if one.family.name not in families | {"friction"}]
    assert others[0].log < found[0].log - 20
    # Of some hundred places the nearest may be so far.
    assert np.linalg.norm([values[f"c{axis}"] for axis in "xyz"] - PLACE) < 0.018
    predictor.destroy()


def test_what_holds_a_piece_of_a_patch_is_found_from_that_patch() -> None:
    """With all of the patch nothing may be seen to be missing, and no score shows what holds the body without it."""
    predictor = pulled(("2", "4"), frozenset("4"), acting(2e6, potential=stopped), (0.5, 1.0))
    state, scores = State.of(predictor, Model.of(predictor.scene), frozenset("24")), TermScores(("boundary",))
    thin = in_few_steps(state)
    assert not CoarseSearch(thin, state.model, among=70).run().full[0].names
    found = CoarseSearch(thin, state.model, among=70, candidates=scores).run().full[0]
    assert (found.anchors, found.names) == (frozenset("4"), ("outer_stop_at_a_spot",))
    # The middle of the patch, where the fit begins, is 20 mm away.
    assert np.linalg.norm([found.term.values[f"c{axis}"] for axis in "xyz"] - HELD) < 0.015
    predictor.destroy()
