"""The hidden study: its cases, its scores, and its processes, which may be killed at any moment."""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, replace
from itertools import chain, combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from bcid.base.shipped import shipped
from bcid.measurement import Measurement
from bcid.scene import Level, Scene
from bcid.scene.uncertainty import Uncertainty
from validation.reliability.kills import alive
from validation.synthetic import cases
from validation.synthetic.bodies import BODIES, FINGER, GALLBLADDER, SLAB
from validation.synthetic.case_scene import write_scene
from validation.synthetic.conditions import Conditions
from validation.synthetic.drawing import CaseChoice, Plan, draw, plan
from validation.synthetic.hidden_study import HiddenOptions, _read, run_hidden
from validation.synthetic.judge import judge, verdict_right
from validation.synthetic.score import scores
from validation.synthetic.score_table import table
from validation.synthetic.study_body import StudyBody
from validation.synthetic.told import calibration
from validation.synthetic.wilson import wilson

HERE = Path(__file__).resolve().parent


# -- cases
# ------------------------------------------------------------------------------------------------------------------


def of(body: str, conditions: str = "all", seed: int = 0) -> CaseChoice:
    return CaseChoice(seed=seed, bodies=(body,), conditions=conditions)


def test_a_case_depends_on_the_choice_and_its_index_alone() -> None:
    first, again = draw(CaseChoice(3), 17), draw(CaseChoice(3), 17, attempt=1)
    assert first == draw(CaseChoice(3), 17)
    assert first != draw(CaseChoice(4), 17)
    assert first.noise != again.noise
    for case in (first, again):
        about = Plan(case.body, case.conditions, case.kind, tuple(h.effect for h in case.hidden))
        assert plan(CaseChoice(3), 17) == about


def test_seeds_and_bodies_differ() -> None:
    plans = [
        [plan(of(body, seed=seed), i) for i in range(20)] for body, seed in (("slab", 0), ("finger", 0), ("slab", 1))
    ]
    for first, second in combinations(plans, 2):
        assert [p.kind for p in first] != [p.kind for p in second]
        assert [p.conditions for p in first] != [p.conditions for p in second]


def test_bodies_take_turns() -> None:
    assert [plan(CaseChoice(), i).body.name for i in range(4)] == ["slab", "gallbladder", "finger", "slab"]
    assert [plan(CaseChoice(bodies=("finger", "slab")), i).body.name for i in range(3)] == ["finger", "slab", "finger"]


@pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))
def test_kinds_and_effects_of_a_body_are_balanced(body: StudyBody) -> None:
    count = 20 * len(body.catalogue)
    plans = [plan(of(body.name), i) for i in range(count)]
    kinds = Counter(p.kind for p in plans)
    assert kinds == {"none": count / 5, "one": count / 2, "two": count / 10, "outside": count / 5}
    ones = Counter(p.effects[0] for p in plans if p.kind == "one")
    assert ones == dict.fromkeys(body.catalogue, 10)
    strange = Counter(p.effects[0] for p in plans if p.kind == "outside")
    assert set(strange) == set(cases.OUTSIDE)
    assert max(strange.values()) - min(strange.values()) <= 1
    twos = [p.effects for p in plans if p.kind == "two"]
    assert all(len(set(names)) == 2 for names in twos)
    assert set(chain.from_iterable(twos)) == set(body.catalogue)


def test_a_body_that_lies_on_nothing_has_no_effects_of_a_support() -> None:
    missing = {"foundation", "support_contact", "support_friction"}
    assert set(SLAB.catalogue) - set(GALLBLADDER.catalogue) == missing
    for body in BODIES.values():
        assert body.supported == bool(Scene.read(shipped(body.scene)).support)


def test_conditions_take_turns() -> None:
    under = Counter(plan(of("finger"), i).conditions for i in range(48))
    ways = [(noise, on, mesh) for noise in ("right", "unstated") for on in (False, True) for mesh in ("fine", "coarse")]
    assert all(under[Conditions(*way)] == 4 for way in ways)
    wrong = [c for c in under if c.noise in ("half", "double")]
    assert len(wrong) == 8
    assert all(under[c] == 2 for c in wrong)
    assert {plan(of("slab", "exact"), i).conditions for i in range(9)} == {Conditions("right", False, "fine")}
    assert {plan(of("slab", "inexact"), i).conditions for i in range(9)} == {Conditions("right", True, "fine")}


def test_only_the_sizes_change_when_the_small_ones_are_left_out() -> None:
    large_ones = CaseChoice(5, least=4.0)
    every, large = draw(CaseChoice(5), 3), draw(large_ones, 3)
    assert replace(large, hidden=()) == replace(every, hidden=())
    assert [replace(h, target=0.0) for h in large.hidden] == [replace(h, target=0.0) for h in every.hidden]
    assert min(h.target for i in range(60) for h in draw(large_ones, i).hidden) >= 4.0


@pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))
def test_cases_keep_their_ranges(body: StudyBody) -> None:
    for index in range(40):
        case = draw(of(body.name, seed=5), index)
        assert case.body is body
        assert case.anchors in body.sets("release" in {h.effect for h in case.hidden})
        low, high = (1e-4, 5e-4) if case.conditions.nuisances else body.noise
        assert low <= case.noise <= high
        assert all(cases.SIZES[0] <= h.target <= cases.SIZES[1] for h in case.hidden)
        assert len(case.motions) in (4, 5)
        assert any(motion.back for motion in case.motions)
        directions = {motion.direction for motion in case.motions}
        assert {body.pull, body.lift} <= directions
        assert directions & set(body.across)
        assert not {p for m in case.motions for p in body.beside.get(m.grasp, ())} & set(case.anchors)
        clock = np.concatenate([action.clock for action in case.actions])
        assert (np.diff(clock) > 0).all()
        for action, motion in zip(case.actions, case.motions, strict=True):
            assert 6 <= len(action) - 1 <= 10
            reach = np.linalg.norm(action.translation, axis=1)
            assert reach.max() == pytest.approx(motion.amplitude)
            assert reach[-1] == pytest.approx(0.0 if motion.back else motion.amplitude)


@pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))
def test_a_body_and_its_scene_go_together(body: StudyBody) -> None:
    scene = Scene.read(shipped(body.scene))
    assert scene.noise_sigma is None
    assert scene.uncertainty == Uncertainty()
    assert set(chain.from_iterable(body.sound)) == set(scene.patches)
    assert set(scene.grasps) == set(body.grasps)
    assert all(scene.grasps[name].centre == pytest.approx(middle) for name, middle in body.grasps.items())
    assert scene.fiducial_names == [str(i + 1) for i in range(body.fiducials)]
    assert {*body.across, body.pull, body.lift} <= set(body.ways)
    for way in body.ways.values():
        assert np.linalg.norm(way.along) == pytest.approx(1.0, abs=1e-3)
    assert all(set(s) - {p} and tuple(sorted(set(s) - {p})) in body.sound for s in body.sets(True) for p in s)
    assert all(level.degree == 2 for level in scene.levels)
    assert body.true.degree == 3


# -- what the diagnosis gets
# ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("conditions", "stated", "larger"),
    [
        (Conditions("right", False, "fine"), 0.2e-3, 1.0),
        (Conditions("unstated", True, "coarse"), None, 1.4),
        (Conditions("half", False, "coarse"), 0.1e-3, 1.4),
        (Conditions("double", True, "fine"), 0.4e-3, 1.0),
    ],
)
def test_a_scene_states_what_its_user_knows(
    tmp_path: Path, conditions: Conditions, stated: float | None, larger: float
) -> None:
    for body in BODIES.values():
        write_scene(tmp_path / body.name, shipped(body.scene), conditions, 0.2e-3)
        own, seen = Scene.read(shipped(body.scene)), Scene.read(tmp_path / body.name / "scene.toml")
        assert seen.noise_sigma == (None if stated is None else pytest.approx(stated))
        sizes = [level.element_size for level in own.levels]
        assert [level.element_size for level in seen.levels] == pytest.approx([sizes[0], sizes[1] * larger])
        assert seen.geometry.read_bytes() == own.geometry.read_bytes()
        assert seen.geometry.parent == tmp_path / body.name
        assert seen.fiducials == own.fiducials


# -- scores
# ------------------------------------------------------------------------------------------------------------------


EXACT, WRONG, ON = Conditions(), Conditions("half"), Conditions(nuisances=True)


def parameter(value: float, role: str = "amount", **more: Any) -> dict[str, Any]:
    plain = {"unit": "1", "neutral": 0.0, "reciprocal": False, "scale": 1.0, "period": None}
    return plain | {"value": value, "role": role} | more


def ranked(*names: str) -> list[dict[str, str]]:
    return [{"effect": name} for name in names]


def result(
    kind: str, effects: list[dict[str, Any]], size: float = 5.0, under: Conditions = EXACT, **diagnosis: Any
) -> dict[str, Any]:
    effects = [one | {"size": size} for one in effects]
    truth = {"kind": kind, "anchored": ["3", "4"], "noise": 2e-4, "size": size, "effects": effects}
    truth |= {"body": "slab", "not_asked": ["2"], "conditions": asdict(under)}
    answer = {
        "adequate": False,
        "verdict": "gravity",
        "anchored": ["4", "3"],
        "ranking": ranked("gravity", "fibres", "viscosity"),
        "selected_effects": adopted("gravity", weight=11.0),
        "held_out_rms": 0.21,
        "noise_rms": 0.1,
    }
    state = {"index": 0, "state": "done", "reason": "", "seconds": 2.0, "cpu_seconds": 1.5}
    return state | {"truth": truth, "diagnosis": answer | diagnosis}


def effect(name: str = "gravity", place: str = "", **parameters: dict[str, Any]) -> dict[str, Any]:
    return {"effect": name, "outside": False, "place": place, "parameters": parameters or {"weight": parameter(10.0)}}


def adopted(name: str, place: str = "", **values: float) -> list[dict[str, Any]]:
    """With standard errors of a tenth."""
    parameters = {n: {"value": v, "stderr": abs(v) / 10} for n, v in values.items()}
    return [{"effect": name, "place": place, "parameters": parameters}]


def at_bound(name: str, number: str, value: float, limit: float) -> list[dict[str, Any]]:
    """With a number that ended at a bound, whose standard error would reach far."""
    return [{"effect": name, "place": "", "parameters": {number: {"value": value, "stderr": 5.0, "limit": limit}}}]


GRAVITY = [effect()]
ANGLED = [effect("fibres", k1=parameter(5.0), angle=parameter(175.0, "shape", unit="deg", period=180.0))]
VECTOR = [effect("prestrain", sx=parameter(1.1, neutral=1.0, scale=0.1), sz=parameter(1.0, neutral=1.0, scale=0.1))]
BALL = [
    effect(
        "inclusion",
        ratio=parameter(3.0, neutral=1.0),
        **{n: parameter(v, "shape") for n, v in {"cx": 0.05, "cy": 0.005, "cz": 0.05, "radius": 0.02}.items()},
    )
]
SPRING = [effect("soft_anchor", "3", stiffness=parameter(1e5, neutral=None, reciprocal=True))]


@pytest.mark.parametrize(
    ("goal", "kind", "effects", "right", "wrong"),
    [
        ("named", "one", GRAVITY, {}, {"verdict": "gravity+fibres"}),
        ("first", "one", GRAVITY, {}, {"ranking": ranked("fibres", "gravity")}),
        (
            "first two",
            "one",
            GRAVITY,
            {"ranking": ranked("fibres", "gravity")},
            {"ranking": ranked("a", "b", "gravity")},
        ),
        ("parameters", "one", GRAVITY, {}, {"selected_effects": adopted("gravity", weight=12.5)}),
        (
            "parameters",
            "one",
            ANGLED,
            {"selected_effects": adopted("fibres", k1=5, angle=5)},
            {"selected_effects": adopted("fibres", k1=5, angle=12)},
        ),
        (
            "parameters",
            "one",
            VECTOR,
            {"selected_effects": adopted("prestrain", sx=1.1, sz=1.02)},
            {"selected_effects": adopted("prestrain", sx=1.09, sz=1.04)},
        ),
        (
            "parameters",
            "one",
            BALL,
            {"selected_effects": adopted("inclusion", ratio=3.2, cx=0.06, cy=0, cz=0.05, radius=0.03)},
            {"selected_effects": adopted("inclusion", ratio=3, cx=0.08, cy=0, cz=0.05, radius=0.02)},
        ),
        (
            "parameters",
            "one",
            SPRING,
            {"selected_effects": adopted("soft_anchor", "3", stiffness=1.1e5)},
            {"selected_effects": adopted("soft_anchor", "4", stiffness=1e5)},
        ),
        ("held out", "one", GRAVITY, {}, {"held_out_rms": 0.25}),
        (
            "held out, mesh",
            "one",
            GRAVITY,
            {"held_out_rms": 0.29, "discretisation_rms": 0.15},
            {"held_out_rms": 0.31, "discretisation_rms": 0.15},
        ),
        ("intervals", "one", GRAVITY, {}, {"selected_effects": adopted("gravity", weight=12.6)}),
        (
            "intervals",
            "one",
            SPRING,
            {"verdict": "soft_anchor(3)", "selected_effects": adopted("soft_anchor", "3", stiffness=1.19e5)},
            # On the scale of the stiffness itself this one would hold.
            {"verdict": "soft_anchor(3)", "selected_effects": adopted("soft_anchor", "3", stiffness=1.243e5)},
        ),
        (
            "intervals",
            "one",
            GRAVITY,
            {"selected_effects": at_bound("gravity", "weight", 8.0, 10.5)},
            {"selected_effects": at_bound("gravity", "weight", 8.0, 9.5)},
        ),
        ("adequate", "none", [], {"adequate": True, "verdict": "none"}, {}),
        ("not misnamed", "outside", [effect("tear")], {"verdict": "unknown"}, {}),
        ("both", "two", [effect(), effect("fibres")], {"verdict": "gravity+fibres"}, {}),
        ("anchors", "outside", [effect("tear")], {}, {"anchored": ["3"]}),
        ("anchors", "none", [], {"anchored": ["2", "3", "4"]}, {"anchored": ["1", "3", "4"]}),
    ],
)
def test_each_goal_is_met_and_missed(
    goal: str, kind: str, effects: list[dict[str, Any]], right: dict[str, Any], wrong: dict[str, Any]
) -> None:
    good, bad = result(kind, effects, **right), result(kind, effects, **wrong)
    assert judge(good)[goal] == (True,)
    assert judge(bad)[goal] == (False,)
    assert judge(result(kind, effects) | {"diagnosis": None, "state": "timeout"})[goal] == (False,)
    found = scores([good, good, bad])["rates"][goal]
    assert (found["met"], found["count"]) == (2, 3)


@pytest.mark.parametrize(
    ("goal", "under", "right", "wrong"),
    [
        ("named, inexact", ON, {}, {"verdict": "fibres"}),
        ("no false name, inexact", ON, {"verdict": "unknown"}, {"verdict": "gravity+fibres"}),
        ("settled, inexact", ON, {"anchored": ["3"], "anchors_probability": 0.94}, {"anchored": ["3"]}),
        ("held out, inexact", ON, {}, {"held_out_rms": 0.25}),
        ("noise told", WRONG, {"noise_warning": "half the residual"}, {"noise_warning": ""}),
        ("noise trusted", Conditions(), {"noise_warning": ""}, {"noise_warning": "half the residual"}),
    ],
)
def test_goals_of_some_conditions(goal: str, under: Conditions, right: dict[str, Any], wrong: dict[str, Any]) -> None:
    good, bad = (result("one", GRAVITY, under=under, **diagnosis) for diagnosis in (right, wrong))
    other = result("one", GRAVITY, under=Conditions("unstated"), **right)
    found = scores([good, good, bad, other])
    assert (found["rates"][goal]["met"], found["rates"][goal]["count"]) == (2, 3)
    assert found["rates"]["named"]["count"] == (1 if under.nuisances else 4)


def test_the_stiffness_is_asked_for_where_forces_are_felt() -> None:
    def told(value: float) -> dict[str, Any]:
        constant = {"value": value, "stderr": 500.0, "scene": 15e3, "unit": "Pa"}
        found = result("one", GRAVITY, stiffness={"constants": {"young": constant}})
        found["truth"]["stiffness"] = 1.2
        return found

    assert judge(told(18.9e3))["stiffness"] == (True,)
    assert judge(told(19.1e3))["stiffness"] == (False,)
    assert judge(result("one", GRAVITY))["stiffness"] == ()


def test_what_a_diagnosis_does_not_say_is_not_asked() -> None:
    assert judge(result("one", GRAVITY, under=WRONG))["noise told"] == ()
    assert judge(result("one", GRAVITY, verdict="unknown"))["intervals"] == ()
    assert judge(result("one", GRAVITY, selected_effects=[]))["intervals"] == ()
    assert scores([result("one", GRAVITY)])["calibration"]["count"] == 0
    assert "No diagnosis told how probable" in table(scores([result("one", GRAVITY)]))


def test_amounts_that_the_data_cannot_tell_are_not_asked() -> None:
    """Moved by a gripper that never turns a grasp shows its rotation only; where nothing is told nothing is right."""
    offset = [effect("grasp_offset", x=parameter(0.03, scale=0.005), rx=parameter(10.0, scale=5.0))]

    def told(**errors: float) -> dict[str, Any]:
        values = {"x": 0.0, "rx": 10.4}
        numbers = {name: {"value": value, "stderr": errors[name]} for name, value in values.items()}
        entry = {"effect": "grasp_offset", "place": "", "parameters": numbers}
        return judge(result("one", offset, verdict="grasp_offset", selected_effects=[entry]))

    untold = told(x=5e97, rx=0.3)
    assert (untold["parameters"], untold["intervals"]) == ((True,), (True,))
    wrong = told(x=0.001, rx=0.3)
    assert (wrong["parameters"], wrong["intervals"]) == ((False,), (False, True))
    nothing = told(x=5e97, rx=5e97)
    assert (nothing["parameters"], nothing["intervals"]) == ((False,), ())


def test_rates_that_shall_lie_in_a_range() -> None:
    good, bad = result("none", [], adequate=True, verdict="none"), result("none", [], verdict="none")
    reached = [scores([good] * (100 - n) + [bad] * n)["rates"]["adequate"]["reached"] for n in (0, 5, 8)]
    assert reached == [False, True, False]


@pytest.mark.parametrize(
    ("kind", "effects", "size", "verdict", "right"),
    [
        ("one", GRAVITY, 5.0, "gravity", True),
        ("one", GRAVITY, 5.0, "gravity+fibres", False),
        ("one", GRAVITY, 5.0, "none", False),
        ("one", GRAVITY, 5.0, "unknown", False),
        ("one", GRAVITY, 2.0, "none", True),
        ("one", GRAVITY, 2.0, "gravity", True),
        ("one", GRAVITY, 2.0, "fibres", False),
        ("none", [], 0.0, "none", True),
        ("none", [], 0.0, "unknown", False),
        ("outside", [effect("tear")], 5.0, "unknown", True),
        ("outside", [effect("tear")], 5.0, "none", False),
        ("outside", [effect("tear")], 2.0, "none", True),
        ("outside", [effect("tear")], 2.0, "gravity", False),
    ],
)
def test_whether_a_verdict_is_right(
    kind: str, effects: list[dict[str, Any]], size: float, verdict: str, right: bool
) -> None:
    case = result(kind, effects, size, verdict=verdict)
    assert verdict_right(case["truth"], case["diagnosis"]) is right


def test_the_smaller_of_two_effects_may_be_missed() -> None:
    case = result("two", [effect(), effect("fibres")])
    case["truth"]["effects"][1]["size"] = 2.0
    for verdict, right in (("gravity", True), ("gravity+fibres", True), ("fibres", False)):
        assert verdict_right(case["truth"], {"verdict": verdict}) is right


def test_calibration_compares_what_is_told_with_what_is_right() -> None:
    right = result("one", GRAVITY, verdict_probability=0.92, anchors_probability=1.0)
    wrong = result("one", GRAVITY, verdict="fibres", verdict_probability=0.92, anchored=["1"], anchors_probability=0.97)
    modest = result("one", GRAVITY, anchors_probability=0.6)
    found = calibration([right, wrong, modest])
    assert [b["count"] for b in found["bins"]] == [0, 1, 0, 2, 1, 1]
    assert [b["rate"] for b in found["bins"] if b["count"]] == [1.0, 0.5, 0.0, 1.0]
    assert found["expected_error"] == pytest.approx((0.4 + 2 * 0.42 + 0.97) / 5)
    assert (found["sure_and_wrong"]["met"], found["sure_and_wrong"]["count"]) == (1, 2)
    text = table(scores([right, wrong, modest]))
    assert "expected calibration error 0.442 (goal 0.05: NO); by chance alone" in text
    # Written out: one answer that is told with 0.6, two with 0.92, one with 0.97 and one with certainty.
    two = 0.92**2 * 0.16 + 2 * 0.92 * 0.08 * 0.84 + 0.08**2 * 1.84
    assert found["by_chance"] == pytest.approx((2 * 0.6 * 0.4 + two + 2 * 0.97 * 0.03) / 5)
    assert "told with 95 % or more and wrong: 1 of 2" in text


def test_what_is_told_of_patches_that_are_asked_for_is_what_is_told_of_them_beside_the_others() -> None:
    """Patch 2 cannot be told: what is believed of sets with it says nothing of how sure the others are."""
    sets = {("3", "4"): 0.3, ("2", "3", "4"): 0.45, ("3",): 0.05, ("2", "3"): 0.2}
    listed = [
        {"anchored": list(s), "effects": [e], "probability": p / 2} for s, p in sets.items() for e in ("", "gravity")
    ]
    case = result("one", GRAVITY, anchored=["2", "3", "4"], anchors_probability=0.45, posterior={"hypotheses": listed})
    found = calibration([case])
    assert (found["count"], found["sure_and_wrong"]["count"]) == (1, 0)
    (told,) = [b for b in found["bins"] if b["count"]]
    assert told["told"] == pytest.approx(0.3 / 0.35)
    assert told["rate"] == 1.0
    # Where every set that is listed has patch 2, nothing is.
    case["diagnosis"]["posterior"]["hypotheses"] = listed[2:4]
    assert calibration([case])["count"] == 0


def test_a_set_that_is_told_for_sure_is_right_to_the_last_patch() -> None:
    """Also in those that these data cannot tell: there a sure answer is wrong half the time."""
    case = result("none", [], anchored=["2", "3", "4"], anchors_probability=0.96)
    assert judge(case)["anchors"] == (True,)
    assert judge(case)["settled"] == (False,)
    assert calibration([case])["sure_and_wrong"]["met"] == 1
    case["diagnosis"]["anchors_probability"] = 0.5
    assert judge(case)["settled"] == (True,)


def test_goals_ask_only_for_effects_that_can_be_seen() -> None:
    found = scores([result("one", GRAVITY), result("one", GRAVITY, size=1.5, verdict="none")])
    assert (found["rates"]["named"]["met"], found["rates"]["named"]["count"]) == (1, 1)
    assert found["by_size"][1]["rates"]["named"]["rate"] == 0.0
    assert found["by_body"]["slab"]["named"]["count"] == 1
    assert found["confusion"] == {"gravity": {"gravity": 1}, "gravity, small": {"none": 1}}


def test_interval_of_a_rate() -> None:
    assert wilson(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_the_table_names_what_is_missed_and_what_failed() -> None:
    failed = result("one", GRAVITY) | {"state": "failed", "diagnosis": None, "reason": "diagnosis: no such thing"}
    text = table(scores([result("one", GRAVITY), failed, failed | {"truth": None}]))
    assert "50%" in text
    assert "NO" in text
    assert "no such thing" in text
    assert "median 2 (goal 20: yes)" in text


def test_a_case_that_ran_out_of_time_took_longest() -> None:
    late = result("one", GRAVITY) | {"state": "timeout", "diagnosis": None, "cpu_seconds": 0.0}
    assert scores([result("one", GRAVITY)] * 3 + [late])["cpu_seconds"] == {"median": 1.5, "largest": None}
    assert "largest out of time (goal 120: NO)" in table(scores([result("one", GRAVITY), late]))


# -- processes
# ------------------------------------------------------------------------------------------------------------------


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """What the stand-ins were called for."""
    monkeypatch.setenv("PYTHONPATH", str(HERE))
    file = tmp_path / "calls.txt"
    file.touch()
    monkeypatch.setenv("FAKE_STUDY_CALLS", str(file))
    yield file
    for line in file.read_text().splitlines():
        with pytest.raises(ProcessLookupError):
            os.kill(int(line.split()[1]), 0)


def options(count: int, limit: float = 100.0) -> HiddenOptions:
    return HiddenOptions(count, limit=limit, make="fake_study:make", diagnose="fake_study:diagnose")


@pytest.mark.timeout(120)
def test_what_fails_is_recorded_and_stops_nothing(tmp_path: Path, calls: Path) -> None:
    run = run_hidden(tmp_path / "run", options(7, limit=3.0))
    states = [_read(run, i)["state"] for i in range(7)]
    assert states == ["done", "failed", "done", "failed", "done", "timeout", "timeout"]
    assert _read(run, 1)["reason"] == "diagnosis: ValueError: no such thing"
    assert "signal 6, 3 times" in _read(run, 3)["reason"]
    assert [int(line.split()[0]) for line in calls.read_text().splitlines()].count(3) == 3
    assert _read(run, 5)["reason"] == "was not done after 12 s"
    assert _read(run, 6)["reason"] == "took more than 3 CPU s"
    assert _read(run, 5)["truth"]["anchored"] == ["1"]
    found = json.loads((run / "hidden.json").read_text())
    assert found["states"] == {"done": 3, "failed": 2, "timeout": 2}
    assert found["rates"]["adequate"]["met"] == 3
    assert "no such thing" in (run / "table.txt").read_text()
    assert all((run / name).stat().st_size > 1000 for name in ("goals.png", "degradation.png"))
    with pytest.raises(InputError, match="finished"):
        run_hidden(run, options(7, limit=3.0))


def start(run: Path, count: int) -> subprocess.Popen[bytes]:
    code = (
        "from pathlib import Path; from validation.synthetic.hidden_study import *; "
        f"options = HiddenOptions({count}, make='fake_study:make', diagnose='fake_study:diagnose', limit=100.0); "
        f"run_hidden(Path({str(run)!r}), options)"
    )
    return subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)


def wait_for(condition: Any, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_study_that_was_killed_goes_on(
    tmp_path: Path, calls: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    run = tmp_path / "run"
    monkeypatch.setenv("FAKE_STUDY_SLEEP", "1")
    parent = start(run, 5)
    wait_for((run / "results/0000.json").is_file)
    wait_for(lambda: len(calls.read_text().splitlines()) >= 3)
    parent.send_signal(number)
    parent.wait()
    # Orphans end themselves.
    wait_for(lambda: not any(alive(int(line.split()[1])) for line in calls.read_text().splitlines()), 20.0)
    before = {file.name for file in (run / "results").glob("0*.json")}
    assert 0 < len(before) < 5
    # Who interrupts it sees what the cases so far say.
    told = (run / "table.txt").read_text() if number == signal.SIGINT else ""
    assert (f"{len(before)} of 5 cases" in told) is (number == signal.SIGINT)
    assert told == (RunFolder.open(run).read_text("table.txt") if number == signal.SIGINT else "")
    began = len(calls.read_text().splitlines())
    monkeypatch.setenv("FAKE_STUDY_SLEEP", "0")
    run_hidden(run, options(5))
    again = {int(line.split()[0]) for line in calls.read_text().splitlines()[began:]}
    assert sorted(f"{i:04d}.json" for i in again) == sorted({f"{i:04d}.json" for i in range(5)} - before)
    assert [_read(run, i)["state"] for i in range(5)] == ["done", "failed", "done", "failed", "done"]
    assert "Hidden study: 5 cases" in (run / "table.txt").read_text()


def test_options_are_checked(tmp_path: Path) -> None:
    for wrong, said in (
        (HiddenOptions(0), "--cases 0: must be at least 1"),
        (HiddenOptions(bodies=("slap",)), "no body 'slap'; did you mean 'slab'"),
        (HiddenOptions(bodies=("slab", "slab")), "--bodies slab,slab: one is named twice"),
        (HiddenOptions(conditions="exactly"), "--conditions exactly: did you mean 'exact'"),
    ):
        with pytest.raises(InputError, match=said):
            run_hidden(tmp_path / "run", wrong)
    assert not (tmp_path / "run").exists()


# -- truth
# ------------------------------------------------------------------------------------------------------------------


def test_the_dose_is_found_that_has_the_wanted_size() -> None:
    from bcid.base.errors import SolveError
    from validation.synthetic.truth import search

    assert search(lambda t: 0.3 * t, 5.0, 100.0) == pytest.approx(5 / 0.3, rel=0.11)
    assert search(lambda t: t**2, 5.0, 100.0) == pytest.approx(5**0.5, rel=0.11)
    assert search(lambda t: 0.3 * t, 5.0, 4.0) == 4.0
    assert search(lambda t: max(0.0, 8 * (t - 1.2)), 2.0, 1.5) == pytest.approx(1.45, rel=0.03)
    assert search(lambda t: 10 * t if t < 0.4 else None, 3.0, 100.0) == pytest.approx(0.3, rel=0.11)
    with pytest.raises(SolveError):
        search(lambda t: None, 3.0, 10.0)


def test_an_effect_at_its_bounds_gets_less_noise() -> None:
    from validation.synthetic.truth import quieter

    case = replace(draw(CaseChoice(), 0), noise=4e-4, hidden=(cases.Hidden("gravity", 5.0),))
    assert quieter(case, [4.8]) == 4e-4
    assert quieter(case, [2.5]) == pytest.approx(2e-4)
    assert quieter(case, [0.1]) == SLAB.noise[0]
    assert quieter(replace(case, hidden=()), []) == 4e-4


def test_half_steps_keep_the_commanded_frames() -> None:
    from validation.synthetic.truth import halved

    action = draw(CaseChoice(), 1).actions[1]
    fine = halved(action, 100)
    assert len(fine) == 2 * len(action) - 1
    assert list(fine.frames[::2]) == list(action.frames)
    assert np.array_equal(fine.translation[::2], action.translation)
    assert fine.clock[1] == pytest.approx(action.clock[:2].mean())
    assert fine.translation[1] == pytest.approx(action.translation[:2].mean(axis=0))


def test_an_anchor_that_cannot_be_seen_is_not_asked_for() -> None:
    from bcid.base.errors import SolveError
    from validation.synthetic.truth import visible

    case = replace(draw(CaseChoice(), 0), anchors=("1", "2"), noise=4e-4)
    assert visible(case, {"1": 5e-4, "2": 6e-4, "3": 0.0}) == 4e-4
    assert visible(case, {"1": 5e-4, "2": 2e-4, "3": 0.0}) == 2e-4
    assert visible(case, {"1": float("nan"), "2": 9e-4}) == 4e-4
    with pytest.raises(SolveError):
        visible(case, {"1": 5e-4, "2": 0.5e-4})


@pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))
def test_a_laboratory_has_everything_slightly_wrong(body: StudyBody) -> None:
    from bcid.forms.mesh import level_mesh
    from bcid.forms.mesh.body_mesh import volumes
    from bcid.forms.model import Model
    from validation.synthetic.inexact import Inexact

    scene = Scene.read(shipped(body.scene))
    scene = replace(scene, levels=(body.coarse,))
    mesh = level_mesh(scene, body.coarse)
    for seed in range(3):
        wrong = Inexact.draw(np.random.default_rng(seed), scene, mesh, 2)
        moved = wrong.mesh(scene, mesh)
        assert volumes(moved.points, moved.cells).min() > 0.2 * volumes(mesh.points, mesh.cells).min()
        assert moved.volume == pytest.approx(mesh.volume * wrong.thickness, rel=0.01)
        shifts = np.array(wrong.markers)
        assert 0.2e-3 < np.sqrt(np.mean(shifts**2)) < 0.6e-3
        true = wrong.scene(scene)
        model, stated = Model.of(true), Model.of(scene)
        constants, own = model.law.complete(model.values), stated.law.complete(stated.values)
        assert model.law.name != stated.law.name
        ratio = own["poisson"] + wrong.poisson
        assert model.law.shear(constants) == pytest.approx(own["young"] / (2 + 2 * ratio))
        assert model.law.bulk(constants) == pytest.approx(own["young"] / (3 - 6 * ratio))


def test_markers_stay_on_the_surface_and_borders_move() -> None:
    from bcid.forms.mesh import level_mesh
    from validation.synthetic.inexact import Inexact

    scene = replace(Scene.read(shipped(FINGER.scene)), levels=(FINGER.coarse,))
    mesh = level_mesh(scene, FINGER.coarse)
    wrong = replace(Inexact.draw(np.random.default_rng(0), scene, mesh, 1), borders=(1e-3, -1e-3), thickness=1.0)
    # The top is flat, and y points up.
    assert np.abs(np.array(wrong.markers)[:, 1]).max() < 1e-12
    shift = wrong.mesh(scene, mesh).points - mesh.points
    patch = np.unique(mesh.groups["patch_5"])
    assert 0.5e-3 < np.abs(shift[patch, 0]).max() <= 1e-3
    assert np.abs(shift[:, 1]).max() < 1e-12
    assert np.allclose(mesh.points.min(axis=0), (mesh.points + shift).min(axis=0))


def reduced(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Coarse elements and short motions, so that a case is made in seconds."""
    import validation.synthetic.drawing as drawing

    body = BODIES[name]
    quick = replace(
        body,
        true=Level(3, body.coarse.element_size * 1.8),
        coarse=Level(2, body.coarse.element_size * 1.8),
        sound=(body.sound[0],),
    )
    monkeypatch.setitem(drawing.BODIES, name, quick)


@pytest.mark.slow
@pytest.mark.parametrize("body", list(BODIES))
def test_a_case_of_each_body_can_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str) -> None:
    from validation.synthetic import truth

    choice = of(body, "inexact")
    index = next(i for i in range(400) if plan(choice, i).effects == ("camera_offset",))
    reduced(monkeypatch, body)
    truth.make(tmp_path, index, choice)
    told = json.loads((tmp_path / "truth.json").read_text())
    assert told["body"] == body
    assert told["conditions"] == {"noise": "right", "nuisances": True, "mesh": "fine", "forces": False}
    assert told["effects"][0]["size"] == pytest.approx(told["effects"][0]["target"], rel=0.4)
    assert not set(told["not_asked"]) & set(told["anchored"])
    scene, seen = Scene.read(tmp_path / "scene.toml"), Measurement.read(tmp_path / "measurement")
    assert seen.noise_sigma is None
    assert scene.noise_sigma == pytest.approx(told["noise"], rel=1e-3)
    assert [str(name) for name in seen.data["fiducial"].values] == scene.fiducial_names


@pytest.mark.slow
def test_a_case_with_forces_has_those_of_a_body_that_is_not_as_stiff_as_its_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from validation.synthetic import truth
    from validation.synthetic.felt import Felt

    choice = of("slab", "forces")
    index = next(i for i in range(400) if plan(choice, i).kind == "none" and not plan(choice, i).conditions.nuisances)
    reduced(monkeypatch, "slab")
    found = {}
    for stiffness in (1.0, 1.5):
        monkeypatch.setattr(Felt, "draw", lambda rng, exact, stiffness=stiffness: Felt(stiffness))
        truth.make(tmp_path / str(stiffness), index, choice)
        found[stiffness] = Measurement.read(tmp_path / str(stiffness) / "measurement")
    one, stiffer = found.values()
    assert one.wrench_sigma == pytest.approx(0.01 * np.abs(one.wrenches[:, :3]).max(), rel=0.05)
    scatter = 5 * np.repeat([stiffer.wrench_sigma, stiffer.torque_sigma], 3)
    assert (np.abs(stiffer.wrenches - 1.5 * one.wrenches) < scatter).all()
    assert np.allclose(stiffer.positions, one.positions, atol=1e-7)
    assert json.loads((tmp_path / "1.5" / "truth.json").read_text())["stiffness"] == 1.5


@pytest.mark.slow
def test_the_same_case_is_the_same_measurement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from validation.synthetic import truth

    choice = of("finger", "exact")
    index = next(i for i in range(400) if plan(choice, i).effects == ("time_lag",))
    reduced(monkeypatch, "finger")
    for name in ("a", "b"):
        truth.make(tmp_path / name, index, choice)
    files = sorted(file.relative_to(tmp_path / "a") for file in (tmp_path / "a").rglob("*") if file.is_file())
    assert len(files) == 6
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    shown = "".join(file.read_text() for file in (tmp_path / "a/measurement").iterdir())
    shown += (tmp_path / "a/scene.toml").read_text()
    assert not [name for name in (*SLAB.catalogue, *cases.OUTSIDE) if name in shown]
