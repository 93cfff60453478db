"""Exploration: bits of information, Bayes' rule, the choice of pulls, the loop and its robots, on bodies that are made up."""

import math
import threading
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import quad
from scipy.stats import norm

from bcid.base.errors import InputError, MachineError
from bcid.base.options import ExploreOptions
from bcid.exploration.choice import Chooser, credible_set
from bcid.exploration.hypothesis_predictions import HypothesisPredictor
from bcid.exploration.loop import check
from bcid.exploration.moves import Move, cost, limits_of, moves
from bcid.exploration.posterior_summary import PosteriorSummary
from bcid.exploration.robots import Folder
from bcid.forms.probes import Sensitivities, SensitivityRequest
from bcid.forms.simulate import recorded
from bcid.inference.data import Data
from bcid.inference.hypotheses import Hypothesis, effects, entropy, patches
from bcid.inference.information import coordinates, information, noise_free
from bcid.inference.nuisances import NuisanceModes
from bcid.measurement import Action, Measurement
from bcid.predict.pull_prediction import PullPrediction
from bcid.predict.pull_predictor import PullTangent, small_action
from bcid.predict.questions import of_pull
from bcid.scene import Grasp, Level, Limits, Material, Region, Scene
from bcid.search.hill_climbing import all_candidates

Anchored = frozenset[str]
AXES = {"+x": (1.0, 0.0, 0.0), "+y": (0.0, 1.0, 0.0), "+z": (0.0, 0.0, 1.0)}
LIMITS = Limits(0.01, amplitudes=(0.01,), directions=AXES)


def scene(names: str = "12", limits: Limits | None = LIMITS, grasps: str = "A") -> Scene:
    return Scene(
        "made up",
        Path("none.geo"),
        1.0,
        (Level(),),
        Material("neo_hooke", {}),
        {name: Region() for name in names},
        {name: Grasp(Region(), (0.0, 0.0, 0.0)) for name in grasps},
        {str(i): (0.01 * i, 0.0, 0.0) for i in range(4)},
        limits=limits,
    )


def grip_modes(data: Data, slack: float) -> NuisanceModes:
    """The gripper is off along x, in each action anew."""
    names = [number for number in range(len(data.actions)) if slack]
    moving = (data.axis == 0) & (data.step > 0)
    columns = [np.where((data.action == number) & moving, slack, 0.0) for number in names]
    common = np.column_stack([*columns, np.zeros((len(data), 0))])
    return NuisanceModes(np.zeros((len(data), 3)), common, ("grip",) * len(names), {"grip": slack} if names else {})


class MadeUp:
    """A body whose fiducials follow the gripper by a factor: of the anchor set, the direction and the grasp."""

    comm = MPI.COMM_SELF
    level = 0
    model = None
    gripper = None

    def __init__(self, of: Scene, factor: Callable[[Anchored, str, int], float], **numbers: float) -> None:
        self.scene, self.factor, self.numbers = of, factor, {"force": 0.0, "strain": 0.0, "eigenvalue": 1.0} | numbers
        self.evaluations = 0
        self.slack = 0.0
        self.asked: set[Any] = set()

    def predict(
        self, tasks: Iterable[tuple[Anchored, Action]], detailed: bool = False, models: object = None
    ) -> list[PullPrediction]:
        tasks = list(tasks)
        self.asked.update((of_pull(action), anchors) for anchors, action in tasks)
        return [self._one(anchors, action, detailed) for anchors, action in tasks]

    def small_steps(self, sets: Iterable[Anchored], grasp: str, size: float) -> list[PullPrediction]:
        return self.predict([(anchors, small_action(grasp, size)) for anchors in sets])

    @property
    def nuisances(self) -> Any:
        """Nothing but the gripper may be off, by `slack` (m) along x in every pull."""
        return SimpleNamespace(modes=lambda data, found, wanted, model, predicted: grip_modes(data, self.slack))

    def differentiate(self, tasks: Iterable[tuple[Anchored, Action]]) -> list[PullTangent | None]:
        return [PullTangent(Sensitivities([], {}), SensitivityRequest()) for _ in tasks]

    def _one(self, anchors: Anchored, action: Action, detailed: bool) -> PullPrediction:
        self.evaluations += 1
        factors = np.array([self.factor(anchors, action.grasp, axis) for axis in range(3)])
        moved = (action.translation * factors)[:, None, :]
        moved = np.repeat(moved, len(self.scene.fiducials), axis=1)
        positions = self.scene.rest + moved
        return PullPrediction(positions, **self.numbers) if detailed else PullPrediction(positions)


class MadeUpRobot:
    def __init__(self, body: MadeUp, anchors: str, noise: float, seed: int = 0) -> None:
        self.body, self.anchors, self.noise = body, frozenset(anchors), noise
        self.rng = np.random.default_rng(seed)
        self.made: list[str] = []

    def move(self, action: Action) -> None:
        self.action = action
        self.made.append(action.name)

    def observe(self) -> Measurement:
        positions = self.body.predict([(self.anchors, self.action)])[0].positions
        return recorded(self.body.scene, [self.action], positions, self.noise, self.rng, self.action.clock)


def by_count(anchors: Anchored, _grasp: str, axis: int) -> float:
    """Along x every set moves in its own way, along y only the number of patches matters, along z none."""
    code = sum(2 ** (int(name) - 1) for name in anchors)
    return (1 / (1 + code), 1 / (1 + len(anchors)), 0.5)[axis]


# -- information
# ------------------------------------------------------------------------------------------------------------------


def test_information_of_two_hypotheses_is_that_of_a_binary_channel() -> None:
    """I = 1 - E[log2(1 + exp(...))] for two equally likely Gaussians, by quadrature."""
    for distance in (0.3, 1.0, 2.5, 6.0):
        shown = np.array([np.zeros(5), np.full(5, distance / math.sqrt(5))])
        found = information(shown, np.array([0.5, 0.5]), 4000, 1)

        def lost(x: float, d: float = distance) -> float:
            return float(norm.pdf(x) * np.log2(1 + np.exp(-d * x - d**2 / 2)))

        exact = 1 - quad(lost, -10, 10)[0]
        assert abs(found.bits - exact) < 4 * found.error + 1e-4
        assert found.error < 0.03


def test_information_depends_on_the_probabilities() -> None:
    far = 50 * np.eye(3)
    p = np.array([0.7, 0.2, 0.1])
    assert information(far, p, 1000, 0).bits == pytest.approx(entropy(p), abs=1e-9)
    assert noise_free(far, p).bits == pytest.approx(entropy(p), abs=1e-9)
    assert information(np.ones((3, 4)), p, 1000, 0).bits == 0.0
    assert noise_free(np.ones((3, 4)), p).bits == pytest.approx(0.0, abs=1e-12)
    assert information(far, np.array([1.0, 0.0, 0.0]), 1000, 0).bits == pytest.approx(0.0, abs=1e-9)


def test_few_coordinates_keep_all_distances() -> None:
    shown = np.random.default_rng(0).normal(size=(6, 300))
    places = coordinates(shown)
    assert places.shape[1] <= 5

    def distances(x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(x[:, None] - x[None], axis=2)

    np.testing.assert_allclose(distances(places), distances(shown), rtol=1e-9, atol=1e-9)


# -- belief
# ------------------------------------------------------------------------------------------------------------------


def test_the_choice_knows_what_may_be_off() -> None:
    body = MadeUp(scene(), by_count)
    bits = {}
    for slack in (0.0, 5e-3):
        body.slack = slack
        found = chooser(body, noise=2e-3, look_ahead=False)
        bits[slack] = {o.move.direction: o.expected.bits for o in found.choose(before(found.scene), None).options}
    assert bits[5e-3]["+x"] < 0.8 * bits[0.0]["+x"]
    assert bits[5e-3]["+y"] == pytest.approx(bits[0.0]["+y"], abs=0.05)


def test_patches_add_up() -> None:
    believed = {
        Hypothesis(frozenset("12")): 0.5,
        Hypothesis(frozenset("2"), "gravity"): 0.25,
        Hypothesis(frozenset()): 0.25,
    }
    found = patches(believed, "123")
    assert effects(believed, ["gravity", "fibres"]) == {"": 0.75, "gravity": 0.25, "fibres": 0.0}
    assert found == {"1": 0.5, "2": 0.75, "3": 0.0}
    assert entropy([0.5, 0.25, 0.25]) == 1.5


# -- pulls
# ------------------------------------------------------------------------------------------------------------------


def test_every_pull_keeps_the_limit_and_returns_to_rest() -> None:
    limits = replace(LIMITS, amplitudes=(0.01, 0.004), steps=3)
    found = moves(scene(limits=limits, grasps="AB"))
    assert len(found) == 2 * 2 * 3
    assert [m.amplitude for m in found] == sorted((m.amplitude for m in found), reverse=True)
    for move in found:
        action = move.action(limits, "7")
        assert action.name == "7"
        way = np.linalg.norm(action.translation, axis=1)
        assert way.max() == pytest.approx(move.amplitude)
        assert len(action) == 7
        assert way[0] == way[-1] == 0.0


def test_changing_the_grasp_costs_more() -> None:
    limits = replace(LIMITS, cost=2.0, regrasp=0.5)
    a, b = Move("A", "+x", 0.01), Move("B", "+x", 0.01)
    assert [cost(a, None, limits), cost(a, a, limits), cost(b, a, limits)] == [2.0, 2.0, 2.5]


def test_a_scene_without_limits_is_refused() -> None:
    with pytest.raises(InputError, match=r"\[explore\] table"):
        limits_of(scene(limits=None))
    with pytest.raises(InputError, match="no grasp"):
        limits_of(scene(grasps=""))


def test_motions_are_the_same_whatever_their_name() -> None:
    one, other = Move("A", "+x", 0.01).action(LIMITS, "1"), Move("A", "+x", 0.01).action(LIMITS, "2")
    assert of_pull(one) == of_pull(other)
    assert of_pull(one) == of_pull(replace(one, translation=one.translation * -1.0 * -1.0 + 1e-12))
    assert of_pull(one) != of_pull(Move("A", "+y", 0.01).action(LIMITS))
    slower = replace(one, times=2 * one.clock)
    assert of_pull(one) == of_pull(slower)
    assert of_pull(one, timed=True) != of_pull(slower, timed=True)


# -- the choice
# ------------------------------------------------------------------------------------------------------------------


def chooser(body: MadeUp, noise: float = 1e-4, **more: Any) -> Chooser:
    options = {"criterion": "information", "look_ahead": True, "samples": 2000, "random_state": 0} | more
    predictor = HypothesisPredictor(body)  # type: ignore[arg-type]
    return Chooser(body.scene, predictor, tuple(moves(body.scene)), noise=noise, **options)


def before(of: Scene) -> PosteriorSummary:
    """What is believed before any pull."""
    return PosteriorSummary.before(all_candidates(list(of.patches)), of.patches, (), fine=False)


@pytest.mark.parametrize("criterion", ["information", "entropy"])
def test_the_pull_that_tells_most_is_chosen(criterion: str) -> None:
    found = chooser(MadeUp(scene(), by_count), criterion=criterion)
    choice = found.choose(before(found.scene), None)
    assert choice.move == Move("A", "+x", 0.01)
    assert choice.expected.bits == pytest.approx(2.0, abs=0.01)
    bits = {o.move.direction: o.expected.bits for o in choice.options}
    assert bits["+y"] == pytest.approx(1.5, abs=0.01)
    assert bits["+z"] == 0.0


@pytest.mark.parametrize(
    ("limit", "numbers", "words"),
    [
        ({"force": 1.0}, {"force": 1.1}, "force may exceed 1 N"),
        ({"strain": 0.2}, {"strain": 0.3}, "strain may exceed 0.2"),
        ({}, {"eigenvalue": 0.4}, "may buckle"),
    ],
)
def test_a_pull_beyond_the_limits_is_not_made(limit: dict[str, float], numbers: dict[str, float], words: str) -> None:
    body = MadeUp(scene(limits=replace(LIMITS, **limit)), by_count, **numbers)
    found = chooser(body)
    choice = found.choose(before(found.scene), None)
    assert choice.move is None
    assert all(words in o.forbidden for o in choice.options)


@pytest.mark.parametrize("criterion", ["information", "random"])
def test_a_pull_that_the_fine_level_cannot_follow_is_not_made(criterion: str) -> None:
    """The best pull is along +x; on the fine level that fails with one of four sets."""

    def lost(anchors: Anchored, grasp: str, axis: int) -> float:
        return math.nan if axis == 0 and anchors == frozenset("1") else by_count(anchors, grasp, axis)

    body = MadeUp(scene(), by_count)
    body_fine = MadeUp(scene(), lost)
    found = chooser(body, criterion=criterion)
    found = replace(found, predictor=HypothesisPredictor(body, body_fine))  # type: ignore[arg-type]
    choice = found.choose(before(found.scene), None)
    assert choice.move is None or choice.move.direction != "+x"
    assert criterion == "random" or any("may buckle" in o.forbidden for o in choice.options)


def test_a_dear_pull_must_tell_more() -> None:
    """With grasp B a pull tells 2 bits, with A 1.5, which is more for its cost where changing the grasp costs as much again."""

    def factor(anchors: Anchored, grasp: str, axis: int) -> float:
        return by_count(anchors, grasp, 0 if grasp == "B" else 1)

    limits = replace(LIMITS, directions={"+x": AXES["+x"]}, regrasp=1.0)
    found = chooser(MadeUp(scene(limits=limits, grasps="AB"), factor), look_ahead=False)
    view = before(found.scene)
    assert found.choose(view, None).move == Move("B", "+x", 0.01)
    assert found.choose(view, Move("A", "+x", 0.01)).move == Move("A", "+x", 0.01)


def test_looking_ahead_finds_the_pair() -> None:
    """Along +x and +z only patch 2 shows, along +y only patch 1: each pull tells one bit, and only a pair with +y decides."""
    sizes = {"": (0, 0, 0), "1": (0, 1, 0), "2": (1, 0, 1), "12": (1, 1, 1)}

    def factor(anchors: Anchored, _grasp: str, axis: int) -> float:
        return 0.5 + 0.1 * sizes["".join(sorted(anchors))][axis]

    body = MadeUp(scene(), factor)
    found = chooser(body)
    choice = found.choose(before(found.scene), None)
    values = {o.move.direction: o.expected.bits for o in choice.options}
    assert values == pytest.approx({"+x": 1.0, "+y": 1.0, "+z": 1.0}, abs=0.01)
    assert choice.move is not None
    pair = {choice.move.direction, choice.ahead.direction if choice.ahead else "+y"}
    assert "+y" in pair


def test_the_live_sets_hold_nearly_all_probability() -> None:
    view = before(scene())
    assert len(credible_set(view)) == 4
    sure = replace(view, probabilities={Hypothesis(frozenset("1")): 0.9995, Hypothesis(frozenset("2")): 0.0005})
    assert credible_set(sure) == [Hypothesis(frozenset("1"))]


# -- the loop
# ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"confidence": 1.0}, "--confidence 1"),
        ({"budget": 0.0}, "--budget 0"),
        ({"criterion": "best"}, "known: information, entropy, random"),
        ({"samples": 1}, "at least 10"),
        ({"level": 3}, "levels 0 to 0"),
        ({"grasps": ("C",)}, "known: A"),
    ],
)
def test_a_wrong_plan_is_refused(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        check(ExploreOptions(**wrong), scene())


# -- the folder robot
# ------------------------------------------------------------------------------------------------------------------


def test_a_folder_is_asked_once_and_waited_for(tmp_path: Path) -> None:
    body = MadeUp(scene(), by_count)
    action = Move("A", "+x", 0.01).action(LIMITS, "1")
    robot = Folder(tmp_path, body.scene, wait=20.0)
    robot.move(action)
    asked = (tmp_path / "0001/wanted.csv").read_text()
    assert asked.splitlines()[0] == "action,step,time,grasp,x,y,z,qw,qx,qy,qz"
    assert asked.splitlines()[5] == "1,4,4,A,10,0,0,1,0,0,0"
    assert 'length_unit = "mm"' in (tmp_path / "0001/wanted.toml").read_text()
    human = MadeUpRobot(body, "1", 1e-4)
    human.move(action)
    later = threading.Timer(0.5, lambda: human.observe().write(tmp_path / "0001/measurement"))
    later.start()
    seen = robot.observe()
    later.join()
    assert seen.actions[0].grasp == "A"
    robot.move(action)
    assert (tmp_path / "0001/wanted.csv").read_text() == asked
    with pytest.raises(InputError, match="asks for another pull already"):
        robot.move(Move("A", "+y", 0.01).action(LIMITS, "1"))


def test_wanted_pull_behind_a_link_is_refused(tmp_path: Path) -> None:
    action = Move("A", "+x", 0.01).action(LIMITS, "1")
    Folder(tmp_path / "first", scene()).move(action)
    (tmp_path / "second/0001").mkdir(parents=True)
    for target in ("first/0001/wanted.csv", "nowhere"):
        link = tmp_path / "second/0001/wanted.csv"
        link.unlink(missing_ok=True)
        link.symlink_to(tmp_path / target)
        with pytest.raises(InputError, match=r"wanted\.csv: cannot be read: .*expected a regular file, no link"):
            Folder(tmp_path / "second", scene()).move(action)
        assert link.is_symlink()


def test_nothing_in_the_folder_ends_the_waiting(tmp_path: Path) -> None:
    robot = Folder(tmp_path, scene(), wait=0.3)
    robot.move(Move("A", "+x", 0.01).action(LIMITS, "1"))
    with pytest.raises(MachineError, match="no measurement after"):
        robot.observe()


def test_a_measurement_of_two_actions_is_refused(tmp_path: Path) -> None:
    body = MadeUp(scene(), by_count)
    action = Move("A", "+x", 0.01).action(LIMITS, "1")
    robot = Folder(tmp_path, body.scene, wait=1.0)
    robot.move(action)
    two = [action, replace(action, name="2", frames=action.frames + len(action))]
    recorded(body.scene, two, np.tile(body.scene.rest, (18, 1, 1)), 1e-4, np.random.default_rng(0)).write(
        tmp_path / "0001/measurement"
    )
    with pytest.raises(InputError, match="holds 2 actions"):
        robot.observe()


# -- the picture
# ------------------------------------------------------------------------------------------------------------------
