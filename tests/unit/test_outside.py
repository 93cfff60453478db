"""Worlds outside the family of models: what is drawn, what is written, and the scoring rule of each kind."""

import json
from pathlib import Path

import numpy as np
import pytest

from bcid.measurement import Measurement
from bcid.scene import Scene
from validation.__main__ import main
from validation.outside import case, score
from validation.outside.worlds import KINDS, PATCHES, draw


def arrays(spec: dict[str, object], toggled: float = 5.0) -> dict[str, np.ndarray]:
    """As the independent code gives them: all markers move by 1 mm a step, 0.5 mm of it along each axis by what is wrong."""
    motion = np.broadcast_to(np.arange(5.0)[None, :, None, None], (3, 5, 16, 3))
    return {"motion": motion, "plain": motion - 0.5, "toggled": np.full((len(PATCHES), 3, 16, 3), toggled)}


def answer(
    kind: str, verdict: str, anchored: list[str], probability: float = 0.97, **truth: object
) -> dict[str, object]:
    spec = draw(kind, 0)
    found = {"verdict": verdict, "verdict_probability": probability}
    found |= {"anchored": anchored, "anchors_probability": probability}
    known = case.truth_of(spec, arrays(spec), 0.1) | truth
    return {"kind": kind, "truth": known, "diagnosis": found, "cpu_seconds": 60.0}


@pytest.mark.parametrize("kind", KINDS)
def test_draw_again_gives_the_same_and_another_index_another(kind):
    assert draw(kind, 3) == draw(kind, 3)
    assert draw(kind, 3)["pulls"] != draw(kind, 4)["pulls"]


@pytest.mark.parametrize("index", range(20))
def test_draw_partly_attached_leaves_half_of_an_anchored_patch(index):
    spec = draw("partly", index)
    partly = spec["world"]["partly"]

    def area(box):
        extent = np.diff(np.array(box), axis=0)[0]
        return np.prod(extent[extent > 0])

    assert partly["patch"] in spec["anchored"]
    assert area(partly["box"]) == pytest.approx(area(PATCHES[partly["patch"]]) / 2)


def test_write_makes_a_scene_and_a_measurement_that_bcid_reads(tmp_path):
    spec = draw("gripper", 0)
    case.write(spec, arrays(spec), tmp_path)
    scene = Scene.read(tmp_path / "scene.toml")
    measured = Measurement.read(tmp_path / "measurement")
    assert list(scene.patches) == list(PATCHES)
    assert len(measured.actions) == 3
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert scene.noise_sigma == pytest.approx(1e-3 * truth["noise"])


def test_noise_makes_what_is_wrong_as_large_as_wanted():
    spec = draw("gripper", 0) | {"wanted": 2.5}
    assert case.noise_of(spec, arrays(spec)) == pytest.approx(0.2)
    assert case.noise_of(spec | {"wanted": 1e3}, arrays(spec)) == pytest.approx(0.1)


def test_truth_patches_that_move_markers_less_than_noise_are_not_asked():
    spec = draw("gripper", 0)
    assert case.truth_of(spec, arrays(spec), 0.1)["not_asked"] == []
    assert case.truth_of(spec, arrays(spec, toggled=0.09), 0.1)["not_asked"] == sorted(PATCHES)


def test_store_and_prepare_give_the_input_back(tmp_path, monkeypatch):
    monkeypatch.setattr(case, "INPUTS", tmp_path / "inputs")
    spec = draw("energy", 1)
    (tmp_path / "made").mkdir()
    case.write(spec, arrays(spec), tmp_path / "made")
    case.store("energy", 1, tmp_path / "made")
    truth = case.prepare("energy", 1, tmp_path / "again", None)
    assert truth == json.loads((tmp_path / "made" / "truth.json").read_text())
    for name in ("scene.toml", "box.geo", "measurement/fiducials.csv"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "made" / name).read_bytes()


@pytest.mark.parametrize(
    ("kind", "verdict", "right"),
    [
        ("control", "none", True),
        ("control", "unknown", False),
        ("gripper", "grasp_compliance", True),
        ("gripper", "unknown", True),
        ("gripper", "none", False),
        ("gripper", "gravity", False),
        ("pressure", "gravity", False),
        ("adhesion", "release(3)", True),
        ("adhesion", "foundation", False),
        ("far-field", "soft_anchor(1) + soft_anchor(2)", True),
    ],
)
def test_right_verdict_of_a_kind_is_what_an_ideal_observer_may_say(kind, verdict, right):
    given = answer(kind, verdict, [])
    assert score.right_verdict(given["truth"], given["diagnosis"]) is right
    assert score.certain_and_wrong(given, "verdict") is not right
    assert score.sure_and_right(given, "verdict") is right


def test_right_verdict_below_three_noises_may_be_none():
    given = answer("energy", "none", [], effects=[{"effect": "energy", "size": 2.0}])
    assert score.right_verdict(given["truth"], given["diagnosis"])


def test_anchors_of_patches_that_the_kind_hides_are_open():
    spec = draw("partly", 0)
    hidden = spec["world"]["partly"]["patch"]
    rest = [patch for patch in spec["anchored"] if patch != hidden]
    assert not score.certain_and_wrong(answer("partly", "unknown", rest), "anchors")
    assert score.certain_and_wrong(answer("partly", "unknown", []), "anchors")


def test_anchors_of_another_body_are_wrong_whatever_they_are():
    given = answer("other-body", "unknown", draw("other-body", 0)["anchored"])
    assert score.certain_and_wrong(given, "anchors")
    assert not score.decidable(given, "anchors")
    assert not score.certain_and_wrong(answer("other-body", "unknown", [], 0.9), "anchors")
    measured = " ".join(draw("other-body", 0)["other"]["anchored"])
    assert f"no set is right (of the other body: {measured})" in "\n".join(score.summary({"other-body-0": given}))


def test_table_two_certain_and_wrong_of_a_kind_miss_the_goal():
    right = answer("control", "none", draw("control", 0)["anchored"])
    wrong = answer("pressure", "gravity", draw("pressure", 0)["anchored"])
    text = score.text({"control-0": right, "pressure-0": wrong})
    assert "goal, at most one certain and wrong in each kind: not missed, by fewer than 20 measurements" in text
    assert "pressure-0: verdict gravity with 0.9700" in text
    text = score.text({"control-0": right, "pressure-0": wrong, "pressure-1": wrong})
    assert "goal, at most one certain and wrong in each kind: missed (pressure)" in text
    assert "goal, at least half sure where it can be decided: missed (pressure)" in text


def test_table_goal_is_met_by_all_measurements_of_a_kind():
    right = answer("control", "none", draw("control", 0)["anchored"])
    text = score.text({f"control-{index}": right for index in range(20)})
    assert "goal, at most one certain and wrong in each kind: met" in text


def test_table_without_an_answer_counts_it_as_such():
    lost = answer("control", "none", []) | {"diagnosis": None}
    assert "missed (control)" in score.text({"control-0": lost})


@pytest.mark.parametrize("count", ["0", "-1", "two"])
def test_outside_command_with_a_wrong_count_says_so(count, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["outside", "-o", str(tmp_path / "run"), "--cases", count])
    assert ended.value.code == 2
    assert "needs a whole number from 1 on" in capsys.readouterr().err
    assert not Path(tmp_path / "run").exists()
