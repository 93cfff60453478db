"""The exploration study: its trials, made on a body that is made up, and its scores."""

import re
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from bcid.base.errors import SolveError
from bcid.exploration.moves import limits_of
from bcid.exploration.pull_posterior import PullPosterior
from bcid.forms.model import check_physics
from bcid.predict.pull_predictor import PullPredictor
from bcid.predict.store import PredictionStore
from bcid.scene import Level, Scene
from bcid.scene.uncertainty import Uncertainty
from validation.exploration.exploration_page import page
from validation.exploration.exploration_scores import scores, table
from validation.exploration.exploration_study import SCENE, Bench, attempted
from validation.exploration.exploration_trials import (
    ANCHORS,
    STRATEGIES,
    ExplorationExtent,
    ExplorationTrial,
    trials,
)
from validation.exploration.ideal_observer import Observer


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory, project: Path) -> Iterator[Bench]:
    """On the slab of the study with four of its patches, on a coarse mesh."""
    scene = Scene.read(project / SCENE, physics=check_physics)
    limits = limits_of(scene)
    directions = {name: limits.directions[name] for name in ("+x", "+z")}
    limits = replace(limits, amplitudes=(6e-3,), displacement=6e-3, directions=directions)
    kept = {name: scene.patches[name] for name in "1234"}
    scene = replace(scene, patches=kept, levels=(Level(2, 0.03),), limits=limits, uncertainty=Uncertainty.none())
    kept = PredictionStore(tmp_path_factory.mktemp("store"), MPI.COMM_SELF, shared=True)
    working = PullPredictor(scene, 0, MPI.COMM_SELF, kept)
    made = Bench(scene, working, None, working, 0)
    yield made
    made.destroy()


def test_every_trial_has_a_name_of_its_own() -> None:
    every = list(trials(ExplorationExtent(3)))
    assert len({trial.name for trial in every}) == len(every)
    assert sum(bool(t.hidden) for t in every) == 4
    every = [t for t in every if not t.hidden and t.anchors in ANCHORS]
    settings = {(t.anchors, t.grasps) for t in every}
    assert len(settings) == 2 * len(ANCHORS)
    # Nothing is drawn without noise but by random choice.
    quiet = [t for t in every if t.noise == 0]
    assert sum(t.strategy == "random" for t in quiet) == 3 * len(settings)
    assert sum(t.strategy == "information" for t in quiet) == len(settings)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_trial_finds_the_anchors(bench: Bench, strategy: str) -> None:
    made = bench.make(ExplorationTrial(("1", "2"), 0.3e-3, ("II",), strategy, 4))
    assert made["right"]
    assert made["reason"] == "decided"
    assert made["pulls"] == len(made["moves"]) == len(made["gained"])
    if strategy == "fixed":
        assert len(set(made["moves"])) == 1
    if strategy != "random":
        assert made["moves"][0].startswith("grasp II along +")


def test_a_trial_that_fails_is_recorded(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object) -> None:
        raise SolveError("the fine level cannot be followed")

    monkeypatch.setattr(PullPosterior, "after", lost)
    found = attempted(bench, ExplorationTrial(("1", "2"), 1e-3, ("II",), "information", 0))
    assert found["reason"].startswith("failed: the fine level cannot be followed")
    assert scores([found])["rows"][0]["decided"] == 0


def test_the_page_shows_the_beliefs_after_each_pull(bench: Bench) -> None:
    """Tables 8 to 10 of the paper: pulls without noise, rates by noise, and the laboratory iteration by iteration."""
    extent = ExplorationExtent(1, (0.0, 0.3e-3), (), (), strategies=("entropy",), felt=0.0)
    results = [bench.make(trial) for trial in trials(extent)]
    for result in results:
        assert len(result["beliefs"]) == len(result["asked"]) == result["pulls"]
        assert max(result["beliefs"][-1].values()) == pytest.approx(result["probability"], abs=1e-6)
        assert result["asked"] == sorted(result["asked"])
        assert result["asked"][-1] == result["calls"] > 0
    text = page(results, 0.5, True)
    assert text.startswith("## Active exploration\n\nSection 7 and 8, ")
    for part in ("Table 8: ", "Table 9: ", "Table 10(a): ", "Table 10(b): ", "![Belief in the candidate sets"):
        assert part in text
    first = next(r for r in results if r["noise"] == 0.3e-3 and len(r["grasps"]) == 1)
    calls = first["asked"][0]
    assert f"| 1 | {first['moves'][0]} | {calls} | {calls * 0.5:.3g} |" in text
    for name in ("{1 2}", "{3 4}", "{1 2 3 4}"):
        assert re.search(re.escape(name) + r" (> 99\.99|99\.9\d) %", text)


def test_an_observer_who_knows_all_but_the_set_makes_the_pull_that_tells_and_is_right_as_often_as_it_says() -> None:
    """Two sets, 1 and 2 noises apart in two pulls of a value each: decided at logarithmic odds of 19, by pulls of 2 noises."""
    observer = Observer(np.array([[[0.0], [1.0]], [[0.0], [2.0]], [[0.0], [0.0]]]), true=0)
    assert observer.choose(np.array([0.5, 0.5]), 1.0) == 1
    # A pull that tells a third set from the others for sure, and nothing else, is worth less than one that tells all apart.
    three = Observer(np.array([[[0.0], [0.0], [1000.0]], [[0.0], [4.0], [8.0]]]), true=0)
    assert three.choose(np.full(3, 1 / 3), 1.0) == 1
    random = np.random.default_rng(1)
    found = [observer.trial(1.0, random) for _ in range(400)]
    assert all(decided for _, decided, _ in found)
    # Wald (1945): at most 5 % are wrong, and the mean is 0.9 ln(19) / 2 = 1.3 pulls, and more as the odds overshoot.
    assert 0.01 < np.mean([not right for _, _, right in found]) < 0.05
    assert 1.3 < np.mean([count for count, _, _ in found]) < 2.2
    assert not any(decided for _, decided, _ in (observer.trial(1e3, random) for _ in range(20)))


def test_trials_of_the_same_number_are_the_same(bench: Bench) -> None:
    trial = ExplorationTrial(("3", "4"), 1e-3, ("I", "II"), "random", 7)
    one, again = bench.make(trial), bench.make(trial)
    assert one | {"seconds": 0} == again | {"seconds": 0}
    other = bench.make(replace(trial, number=8))
    assert one["moves"] != other["moves"] or one["gained"] != other["gained"]


def without_time(made: dict[str, Any]) -> dict[str, Any]:
    """A trial without what differs from run to run."""
    return {key: value for key, value in made["result"].items() if key != "seconds"}


def result(strategy: str, pulls: int, right: bool = True, reason: str = "decided") -> dict[str, Any]:
    trial = asdict(ExplorationTrial(("1", "2"), 1e-3, ("II",), strategy, 0))
    found = ["1", "2"] if right else ["1"]
    numbers = {"pulls": pulls, "calls": 3, "seconds": 0.5, "named": [], "told_by": None, "probability": 0.97}
    return trial | {"reason": reason, "found": found, "right": right} | numbers


def test_scores_count_what_is_right_decided_and_falsely_certain() -> None:
    results = [result("information", 2), result("information", 4, False), result("information", 3, False, "budget")]
    results += [result("random", 5), result("random", 20, True, "inseparable")]
    found = scores(results)
    rows = {row["strategy"]: row for row in found["rows"]}
    told = rows["information"]
    assert (told["trials"], told["decided"], told["right"], told["falsely_certain"]) == (3, 2, 1, 1)
    # No decision counts as the whole budget.
    assert told["pulls"] == 4
    assert rows["random"]["pulls"] == 12.5
    assert found["by_anchors"][0]["pulls"] == {"information": 4, "random": 12.5}
    assert (found["calibration"]["right"], found["calibration"]["answers"]) == (1, 2)
    assert found["wrong"] == {"{1 2} taken for {1}": 2}
    assert "3.1 times" in table(found)


def test_what_is_hidden_and_what_is_enclosed_has_tables_of_its_own() -> None:
    results = [result("information", 2)]
    results += [result("information", k, k < 3) | {"hidden": "fibres", "told_by": k} for k in (1, 2, 3)]
    apart = {"anchors": ["1", "2", "3"], "reason": "inseparable"}
    results += [
        result("information", 4) | apart | {"named": named} for named in ([["1", "2", "3"], ["1", "3"]], [["1", "3"]])
    ]
    found = scores(results)
    assert [row["trials"] for row in found["rows"]] == [1]
    assert found["calibration"]["answers"] == 1
    fibres = next(row for row in found["hidden"] if row["hidden"] == "fibres")
    assert (fibres["trials"], fibres["right"], fibres["told_by"]) == (3, 2, 2)
    assert (found["enclosed"]["inseparable"], found["enclosed"]["truth_named"]) == (2, 1)
    text = table(found)
    assert "fibres              3    67%" in text
    assert 'of 2 ended with "inseparable"' in text
