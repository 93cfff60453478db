"""Explorations of a coarse slab: how they end, and that the posterior after a pull is that of every set evaluated by itself."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from bcid.base.errors import InputError, SolveError
from bcid.base.options import ExploreOptions
from bcid.exploration import pull_posterior
from bcid.exploration.choice import Choice
from bcid.exploration.explore_run import exploration_record
from bcid.exploration.joined import joined
from bcid.exploration.loop import BUDGET, DECIDED, INSEPARABLE, Exploration, explore, posterior_before
from bcid.exploration.moves import Move, limits_of
from bcid.exploration.robots import Simulated
from bcid.forms.model import Model
from bcid.inference.hypotheses import Hypothesis, normalised
from bcid.inference.information import Expected
from bcid.measurement import Measurement
from bcid.measurement.contents import Cloud
from bcid.predict.predictor import Predictor
from bcid.predict.pull_predictor import PullPredictor
from bcid.results.summary import exploration_summary
from bcid.scene import Scene
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.state import State

NOISE = 5e-4
TRUTH = frozenset("34")


@pytest.fixture
def scene(coarse_scene: Path) -> Scene:
    whole = Scene.read(coarse_scene)
    return replace(whole, patches={name: whole.patches[name] for name in "34"})


@pytest.fixture
def working(scene: Scene) -> Iterator[PullPredictor]:
    predictor = PullPredictor(scene, 0, MPI.COMM_SELF)
    yield predictor
    predictor.destroy()


def explored(scene: Scene, working: PullPredictor, noise: float, budget: float = 2.0) -> Exploration:
    plan = ExploreOptions(noise=noise, budget=budget, samples=200, grasps=("II",))
    return explore(scene, Simulated(working, list(TRUTH), noise, 1), plan, working)


def test_anchors_are_decided_and_drawn(scene: Scene, working: PullPredictor, tmp_path: Path) -> None:
    from bcid.base.run_folder import RunFolder
    from bcid.report.export import draw_pictures

    found = explored(scene, working, NOISE)
    assert (found.reason, found.view.best) == (DECIDED, Hypothesis(TRUTH))
    assert len(found.steps) == 1
    assert found.steps[0].gained == pytest.approx(2.0, abs=0.3)
    run, record = RunFolder.start(tmp_path / "run", "explore", {}), exploration_record(scene, ExploreOptions(), found)
    run.write_json("exploration.json", record.to_json())
    run.finish({})
    assert draw_pictures(tmp_path / "run") == [tmp_path / "run/posterior.png"]
    assert json.loads((tmp_path / "run/exploration.json").read_text())["steps"][0]["expected_bits"] > 0
    assert "Pulls:" in exploration_summary(record)


def test_the_budget_ends_it(scene: Scene, working: PullPredictor) -> None:
    dear = replace(scene, limits=replace(limits_of(scene), cost=2.0))
    found = explored(dear, working, 2e-2, 4.0)
    assert found.reason == BUDGET
    assert [step.spent for step in found.steps] == [2.0, 4.0]


def test_what_no_pull_tells_apart_is_named(scene: Scene, working: PullPredictor) -> None:
    found = explored(scene, working, 1.0)
    assert (found.reason, found.steps) == (INSEPARABLE, ())
    assert {h.anchors for h in found.rivals} == {frozenset(s) for s in ("", "3", "4", "34")}


def test_the_posterior_is_that_of_every_set_evaluated_by_itself(scene: Scene, working: PullPredictor) -> None:
    """With so much noise that several sets remain, of which most have the errors of another."""
    noise = 6e-3
    robot = Simulated(working, list(TRUTH), noise, 2)
    pulls = []
    posterior = posterior_before(scene, ExploreOptions(noise=noise), working)
    for number, direction in enumerate(("out", "lift"), start=1):
        robot.move(Move("II", direction, 8e-3).action(limits_of(scene), str(number)))
        pulls.append(robot.observe())
        found = posterior.after(pulls[-1])
    assert found is not None
    predictor, plain = Predictor(scene, joined(pulls, scene), MPI.COMM_SELF), Model.of(scene)
    logs: dict[Hypothesis, float] = {}
    for anchors in (h.anchors for h in found.probabilities):
        logs |= FittedHypothesis.unfitted(State.of(predictor, plain, anchors), plain, 0).logs
    exact: dict[Hypothesis, float] = {}
    for h, p in normalised(logs).items():
        exact[h.known] = exact.get(h.known, 0.0) + p
    assert max(exact.values()) < 0.95
    assert found.probabilities == pytest.approx(exact, abs=0.03)
    predictor.destroy()
    posterior.predictors.destroy()


def test_a_pull_that_no_set_can_follow_changes_nothing(
    scene: Scene, working: PullPredictor, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, calls = pull_posterior.searched, list[object]()

    def lost_at_first(*about: Any) -> Any:
        calls.append(about)
        if len(calls) == 1:
            raise SolveError("no set can be followed")
        return whole(*about)

    monkeypatch.setattr(pull_posterior, "searched", lost_at_first)
    found = explored(scene, working, NOISE)
    first, second = found.steps
    assert first.view.probabilities == {Hypothesis(frozenset(s)): 0.25 for s in ("", "3", "4", "34")}
    # The next pull is compared without it.
    assert (found.reason, second.view.best, len(second.view.seen)) == (DECIDED, Hypothesis(TRUTH), 1)
    assert found.remarks == ("pull 1: cannot be compared: no set can be followed",)


def test_a_pull_that_the_robot_cannot_make_is_not_chosen_again(scene: Scene, working: PullPredictor) -> None:
    asked = list[tuple[float, ...]]()

    class Weak(Simulated):
        def observe(self) -> Measurement:
            assert self._action is not None
            asked.append(tuple(self._action.translation[1]))
            if len(asked) == 1:
                raise SolveError("too weak")
            return super().observe()

    plan = ExploreOptions(noise=NOISE, budget=2.0, samples=200, grasps=("II",))
    first = explored(scene, working, NOISE)
    chosen = Choice(first.steps[0].move, Expected(*first.steps[0].expected), first.steps[0].options)
    robot = Weak(working, list(TRUTH), NOISE, 1)
    found = explore(scene, robot, plan, working, first=chosen)
    assert (found.reason, found.view.best, len(found.steps)) == (DECIDED, Hypothesis(TRUTH), 1)
    assert asked[0] != asked[1]
    assert found.steps[0].spent == 1.0
    assert found.remarks == (f"{chosen.move}: too weak",)
    assert next(o for o in found.steps[0].options if o.move == chosen.move).forbidden == "it cannot be made"


def test_points_of_a_surface_are_refused_in_words(scene: Scene, working: PullPredictor) -> None:
    class DepthCamera(Simulated):
        def observe(self) -> Measurement:
            seen = super().observe()
            cloud = Cloud(np.zeros((1, 3)), np.ones(1), ((seen.action_names[0], 0),), np.zeros(1, np.int64))
            return replace(seen, cloud=cloud)

    with pytest.raises(InputError, match="points of the surface, which explore cannot use"):
        explore(scene, DepthCamera(working, ["3"], NOISE, 1), ExploreOptions(noise=NOISE, samples=50), working)
