"""The hidden study: its cases, its scores, and its processes, which may be killed at any moment."""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.measurement import Measurement
from bcid.studies.hidden import cases
from bcid.studies.hidden.hidden_study import HiddenOptions, _read, run_hidden
from bcid.studies.hidden.score import judge, scores, table, wilson
from benchmarks.reliability.kills import alive

HERE = Path(__file__).resolve().parent


# -- cases
# ------------------------------------------------------------------------------------------------------------------


def test_a_case_depends_on_seed_and_index_alone() -> None:
    assert cases.draw(3, 17) == cases.draw(3, 17)
    assert cases.draw(3, 17) != cases.draw(4, 17)
    assert cases.draw(3, 17).noise != cases.draw(3, 17, attempt=1).noise
    assert cases.plan(3, 17) == (cases.draw(3, 17, 1).kind, tuple(h.effect for h in cases.draw(3, 17, 1).hidden))


def test_kinds_and_effects_are_balanced() -> None:
    plans = [cases.plan(0, i) for i in range(360)]
    assert Counter(kind for kind, _ in plans) == {"none": 72, "one": 180, "two": 36, "outside": 72}
    ones = Counter(names[0] for kind, names in plans if kind == "one")
    assert ones == dict.fromkeys(cases.CATALOGUE, 10)
    assert Counter(names[0] for kind, names in plans if kind == "outside") == dict.fromkeys(cases.OUTSIDE, 24)
    twos = Counter(name for kind, names in plans if kind == "two" for name in names)
    assert twos == dict.fromkeys(cases.CATALOGUE, 4)
    assert all(len(set(names)) == 2 for kind, names in plans if kind == "two")


def test_only_the_sizes_change_when_the_small_ones_are_left_out() -> None:
    every, large = cases.draw(5, 3), cases.draw(5, 3, least=4.0)
    assert replace(large, hidden=()) == replace(every, hidden=())
    assert [replace(h, target=0.0) for h in large.hidden] == [replace(h, target=0.0) for h in every.hidden]
    assert min(h.target for i in range(60) for h in cases.draw(5, i, least=4.0).hidden) >= 4.0


def test_cases_keep_their_ranges() -> None:
    for index in range(60):
        case = cases.draw(5, index)
        assert case.anchors in cases.sound_sets("peeling" in {h.effect for h in case.hidden})
        assert cases.NOISE[0] <= case.noise <= cases.NOISE[1]
        assert all(cases.SIZES[0] <= h.target <= cases.SIZES[1] for h in case.hidden)
        assert len(case.motions) in (4, 5)
        assert any(motion.back for motion in case.motions)
        assert {"x", "up"} <= {motion.direction for motion in case.motions}
        clock = np.concatenate([action.clock for action in case.actions])
        assert (np.diff(clock) > 0).all()
        for action, motion in zip(case.actions, case.motions, strict=True):
            assert 6 <= len(action) - 1 <= 10
            reach = np.linalg.norm(action.translation, axis=1)
            assert reach.max() == pytest.approx(motion.amplitude)
            assert reach[-1] == pytest.approx(0.0 if motion.back else motion.amplitude)


# -- scores
# ------------------------------------------------------------------------------------------------------------------


def parameter(value: float, role: str = "amount", **more: Any) -> dict[str, Any]:
    plain = {"unit": "1", "neutral": 0.0, "reciprocal": False, "scale": 1.0, "period": None}
    return plain | {"value": value, "role": role} | more


def result(kind: str, effects: list[dict[str, Any]], size: float = 5.0, **diagnosis: Any) -> dict[str, Any]:
    truth = {"kind": kind, "anchored": ["3", "4"], "noise": 2e-4, "size": size, "effects": effects}
    answer = {
        "adequate": False,
        "verdict": "gravity",
        "anchored": ["4", "3"],
        "first_ranked": ["gravity", "fibres", "viscosity"],
        "adopted": [{"effect": "gravity", "place": "", "parameters": {"weight": {"value": 11.0}}}],
        "held_out_rms": 0.21,
        "noise_rms": 0.2,
    }
    state = {"index": 0, "state": "done", "reason": "", "seconds": 2.0, "cpu_seconds": 1.5}
    return state | {"truth": truth, "diagnosis": answer | diagnosis}


def effect(name: str = "gravity", place: str = "", **parameters: dict[str, Any]) -> dict[str, Any]:
    return {"effect": name, "outside": False, "place": place, "parameters": parameters or {"weight": parameter(10.0)}}


def adopted(name: str, place: str = "", **values: float) -> list[dict[str, Any]]:
    return [{"effect": name, "place": place, "parameters": {n: {"value": v} for n, v in values.items()}}]


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
        ("first", "one", GRAVITY, {}, {"first_ranked": ["fibres", "gravity"]}),
        ("first two", "one", GRAVITY, {"first_ranked": ["fibres", "gravity"]}, {"first_ranked": ["a", "b", "gravity"]}),
        ("parameters", "one", GRAVITY, {}, {"adopted": adopted("gravity", weight=12.5)}),
        (
            "parameters",
            "one",
            ANGLED,
            {"adopted": adopted("fibres", k1=5, angle=5)},
            {"adopted": adopted("fibres", k1=5, angle=12)},
        ),
        (
            "parameters",
            "one",
            VECTOR,
            {"adopted": adopted("prestrain", sx=1.1, sz=1.02)},
            {"adopted": adopted("prestrain", sx=1.09, sz=1.04)},
        ),
        (
            "parameters",
            "one",
            BALL,
            {"adopted": adopted("inclusion", ratio=3.2, cx=0.06, cy=0, cz=0.05, radius=0.03)},
            {"adopted": adopted("inclusion", ratio=3, cx=0.08, cy=0, cz=0.05, radius=0.02)},
        ),
        (
            "parameters",
            "one",
            SPRING,
            {"adopted": adopted("soft_anchor", "3", stiffness=1.1e5)},
            {"adopted": adopted("soft_anchor", "4", stiffness=1e5)},
        ),
        ("held out", "one", GRAVITY, {}, {"held_out_rms": 0.25}),
        ("adequate", "none", [], {"adequate": True, "verdict": "none"}, {}),
        ("not misnamed", "outside", [effect("peeling")], {"verdict": "unknown"}, {}),
        ("both", "two", [effect(), effect("fibres")], {"verdict": "gravity+fibres"}, {}),
        ("anchors", "outside", [effect("peeling")], {}, {"anchored": ["3"]}),
    ],
)
def test_each_goal_is_met_and_missed(
    goal: str, kind: str, effects: list[dict[str, Any]], right: dict[str, Any], wrong: dict[str, Any]
) -> None:
    good, bad = result(kind, effects, **right), result(kind, effects, **wrong)
    assert judge(good)[goal] is True
    assert judge(bad)[goal] is False
    assert judge(result(kind, effects) | {"diagnosis": None, "state": "timeout"})[goal] is False
    found = scores([good, good, bad])["rates"][goal]
    assert (found["met"], found["count"]) == (2, 3)


def test_goals_ask_only_for_effects_that_can_be_seen() -> None:
    found = scores([result("one", GRAVITY), result("one", GRAVITY, size=1.5, verdict="none")])
    assert (found["rates"]["named"]["met"], found["rates"]["named"]["count"]) == (1, 1)
    assert found["by_size"][1]["rates"]["named"]["rate"] == 0.0
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
    assert (run / "degradation.png").stat().st_size > 1000
    with pytest.raises(InputError, match="finished"):
        run_hidden(run, options(7, limit=3.0))


def start(run: Path, count: int) -> subprocess.Popen[bytes]:
    code = (
        "from pathlib import Path; from bcid.studies.hidden.hidden_study import *; "
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
    began = len(calls.read_text().splitlines())
    monkeypatch.setenv("FAKE_STUDY_SLEEP", "0")
    run_hidden(run, options(5))
    again = {int(line.split()[0]) for line in calls.read_text().splitlines()[began:]}
    assert sorted(f"{i:04d}.json" for i in again) == sorted({f"{i:04d}.json" for i in range(5)} - before)
    assert [_read(run, i)["state"] for i in range(5)] == ["done", "failed", "done", "failed", "done"]


def test_options_are_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--cases 0: must be at least 1"):
        run_hidden(tmp_path / "run", HiddenOptions(0))
    assert not (tmp_path / "run").exists()


# -- truth
# ------------------------------------------------------------------------------------------------------------------


def test_the_dose_is_found_that_has_the_wanted_size() -> None:
    from bcid.base.errors import SolveError
    from bcid.studies.hidden.truth import search

    assert search(lambda t: 0.3 * t, 5.0, 100.0) == pytest.approx(5 / 0.3, rel=0.11)
    assert search(lambda t: t**2, 5.0, 100.0) == pytest.approx(5**0.5, rel=0.11)
    assert search(lambda t: 0.3 * t, 5.0, 4.0) == 4.0
    assert search(lambda t: max(0.0, 8 * (t - 1.2)), 2.0, 1.5) == pytest.approx(1.45, rel=0.03)
    assert search(lambda t: 10 * t if t < 0.4 else None, 3.0, 100.0) == pytest.approx(0.3, rel=0.11)
    with pytest.raises(SolveError):
        search(lambda t: None, 3.0, 10.0)


def test_an_effect_at_its_bounds_gets_less_noise() -> None:
    from dataclasses import replace

    from bcid.studies.hidden.truth import quieter

    case = replace(cases.draw(0, 0), noise=4e-4, hidden=(cases.Hidden("gravity", 5.0),))
    assert quieter(case, [4.8]) == 4e-4
    assert quieter(case, [2.5]) == pytest.approx(2e-4)
    assert quieter(case, [0.1]) == cases.NOISE[0]
    assert quieter(replace(case, hidden=()), []) == 4e-4


def test_half_steps_keep_the_commanded_frames() -> None:
    from bcid.studies.hidden.truth import halved

    action = cases.draw(0, 1).actions[1]
    fine = halved(action, 100)
    assert len(fine) == 2 * len(action) - 1
    assert list(fine.frames[::2]) == list(action.frames)
    assert np.array_equal(fine.translation[::2], action.translation)
    assert fine.clock[1] == pytest.approx(action.clock[:2].mean())
    assert fine.translation[1] == pytest.approx(action.translation[:2].mean(axis=0))


@pytest.mark.slow
def test_the_same_case_is_the_same_measurement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from bcid.scene import Level
    from bcid.studies.hidden import truth
    from bcid.studies.hidden.hidden_study import SCENE

    index = next(i for i in range(40) if cases.plan(0, i) == ("one", ("time_lag",)))
    monkeypatch.setattr(truth.compute, "__defaults__", (Level(3, 0.025), Level(2, 0.025)))
    for name in ("a", "b"):
        truth.make(tmp_path / name, 0, index, SCENE, cases.SIZES[0])
    for file in ("measurement/fiducials.csv", "measurement/grasps.csv", "measurement/measurement.toml", "truth.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    told = json.loads((tmp_path / "a/truth.json").read_text())
    assert told["effects"][0]["size"] == pytest.approx(told["effects"][0]["target"], rel=0.3)
    seen = Measurement.read(tmp_path / "a/measurement")
    assert seen.noise_sigma == pytest.approx(told["noise"])
    everything = "".join(file.read_text() for file in (tmp_path / "a/measurement").iterdir())
    assert not [name for name in (*cases.CATALOGUE, *cases.OUTSIDE) if name in everything]
