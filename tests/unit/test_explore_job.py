"""`bcid explore` as a job: its run folder, what a stopped one keeps, and what it says of a damaged one."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from bcid.base.errors import InputError, MachineError
from bcid.base.options import ExploreOptions
from bcid.base.run_folder import RunFolder
from bcid.exploration.explore_run import _keep, _made, run_exploration
from bcid.exploration.loop import explore, gripper_scale
from bcid.exploration.moves import Move, moves
from bcid.exploration.robots import Simulated
from bcid.predict.pull_prediction import predicted
from bcid.predict.pull_predictor import PullPredictor
from bcid.scene import Level, Scene

# With so much noise two pulls never decide.
NOISE = 2e-2
PLAN = ExploreOptions(noise=NOISE, budget=2, samples=100)


def explored(coarser_scene: Path, robot: str, run: Path, wait: float = 0.3) -> dict[str, Any]:
    run_exploration(coarser_scene, robot, run, PLAN, MPI.COMM_SELF, store=coarser_scene.parent / "store", wait=wait)
    found: dict[str, Any] = json.loads((run / "exploration.json").read_text(encoding="utf-8"))
    return found


def test_a_stopped_exploration_goes_on_with_the_pulls_it_has_made(coarser_scene: Path, tmp_path: Path) -> None:
    lab, run = tmp_path / "lab", tmp_path / "run"
    scene = Scene.read(coarser_scene)
    body = Simulated(PullPredictor(scene, 0, MPI.COMM_SELF), "12", NOISE, 0)
    assert scene.limits is not None
    made = []
    for number in range(1, 3):
        with pytest.raises(MachineError, match="no measurement"):
            explored(coarser_scene, f"folder:{lab}", run)
        assert json.loads((run / "run.json").read_text())["state"] == "failed"
        assert len(list((run / "steps").glob("*/move.json"))) == number - 1
        end = (lab / f"{number:04d}/wanted.csv").read_text().splitlines()[5].split(",")
        move = next(m for m in moves(scene) if m.grasp == end[3] and (m.direction == "out") == (float(end[4]) > 0))
        made.append(move)
        body.move(move.action(scene.limits, str(number)))
        body.observe().write(lab / f"{number:04d}/measurement")
    found = explored(coarser_scene, f"folder:{lab}", run)
    assert [(s["grasp"], s["direction"]) for s in found["steps"]] == [(m.grasp, m.direction) for m in made]
    # The same as one that was never stopped.
    whole = explored(coarser_scene, "simulated:1,2", tmp_path / "whole")
    # But for what the solver leaves open where it begins at other states.
    assert [s["patches"] for s in whole["steps"]] == [pytest.approx(s["patches"], abs=1e-3) for s in found["steps"]]
    body.predictor.destroy()


def on_finer_mesh(scene: Path) -> Scene:
    return replace(Scene.read(scene), levels=(Level(2, 0.017),))


@pytest.mark.parametrize(
    ("file", "old", "new", "told"),
    [
        ("move.json", '"out"', '"lift"', r"move\.json: is missing or damaged \(its checksum is another\)"),
        ("measurement/fiducials.csv", "1\n", "2\n", "measurement: is damaged: it is not what was seen"),
        ("measurement/grasps.csv", ",2,", ",3,", "measurement: is damaged: it is not what was seen"),
    ],
)
def test_a_pull_that_was_changed_is_not_gone_on_with(
    coarser_scene: Path, tmp_path: Path, file: str, old: str, new: str, told: str
) -> None:
    scene, run = Scene.read(coarser_scene), tmp_path / "run"
    body = Simulated(PullPredictor(scene, 0, MPI.COMM_SELF), "12", NOISE, 0)
    move = moves(scene)[0]
    assert scene.limits is not None
    body.move(move.action(scene.limits, "1"))
    RunFolder.start(run, "explore", {}).release()
    _keep(run, move, body.observe())
    body.predictor.destroy()
    ((kept, seen),) = _made(run)
    assert kept == move
    assert len(seen.positions) == 9
    changed = run / "steps/0001" / file
    text = changed.read_text(encoding="utf-8")
    assert old in text
    changed.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=f"{told}.*--overwrite"):
        _made(run)


def test_predictions_are_shared_and_what_is_damaged_is_computed_again(coarser_scene: Path, tmp_path: Path) -> None:
    first = explored(coarser_scene, "simulated:1,2", tmp_path / "one")
    again = explored(coarser_scene, "simulated:1,2", tmp_path / "two")
    assert first["steps"][0]["predicted"] > 0
    assert sum(step["predicted"] for step in again["steps"]) == 0
    assert [s["posterior"] for s in again["steps"]] == [s["posterior"] for s in first["steps"]]
    with pytest.raises(InputError, match="holds a finished run"):
        explored(coarser_scene, "simulated:1,2", tmp_path / "two")
    for file in (tmp_path / "store").iterdir():
        file.write_bytes(file.read_bytes()[:100])
    third = explored(coarser_scene, "simulated:1,2", tmp_path / "three")
    assert [s["posterior"] for s in third["steps"]] == [s["posterior"] for s in first["steps"]]
    assert sum(step["predicted"] for step in third["steps"]) == sum(step["predicted"] for step in first["steps"])


def test_forces_tell_more_and_how_stiff_the_body_is(coarser_scene: Path) -> None:
    """The body is much stiffer than its scene says, which positions do not show."""
    scene, plan = on_finer_mesh(coarser_scene), replace(PLAN, noise=2e-3, wrench_noise=0.01, budget=1, grasps=("II",))
    stiffer = replace(scene.material, values=scene.material.values | {"young": "24 kPa"})
    found = {}
    for told in (plan, replace(plan, wrench_noise=None)):
        predictor = PullPredictor(scene, 0, MPI.COMM_SELF, gripper=gripper_scale(told, scene))
        body = PullPredictor(replace(scene, material=stiffer), 0, MPI.COMM_SELF, gripper=gripper_scale(plan, scene))
        robot = Simulated(body, "12", 2e-3, 0, 0.01)
        found[told.wrench_noise] = explore(scene, robot, told, predictor)
        predictor.destroy()
        body.destroy()
    felt, unfelt = found[0.01], found[None]
    assert felt.steps[0].expected[0] > unfelt.steps[0].expected[0] + 0.3
    assert felt.view.best.anchors == frozenset("12")
    assert felt.view.stiffness is not None
    young = felt.view.stiffness.record().constants["young"]
    young, error = young.value, young.stderr
    assert young == pytest.approx(24e3, abs=3 * error)
    assert young - 15e3 > 2 * error
    assert unfelt.view.stiffness is None
    assert not felt.remarks
    assert "do not count: state their noise with --wrench-noise" in unfelt.remarks[0]


def test_the_way_back_is_not_computed_and_the_same(coarser_scene: Path) -> None:
    """A pull that is followed step by step to its end and back gives what half of it gives."""
    scene = Scene.read(coarser_scene)
    predictor = PullPredictor(scene, 0, MPI.COMM_SELF)
    assert scene.limits is not None
    action = moves(scene)[0].action(scene.limits)
    half = predicted(predictor.forward(), frozenset("34"), action, detailed=True)
    whole = predictor.forward().predict("34", [action]).positions
    # As accurate as pulls are predicted; a frame that is not its own lies 2 mm away.
    np.testing.assert_allclose(half.positions, whole, atol=1e-6)
    # The force that the forward model reports at the end of the pull, and strains that are neither zero nor absurd.
    kept = predictor.forward().predict("34", [action], keep=True)
    wrench = predictor.forward().detail("34", [action], kept).wrench
    assert wrench is not None
    assert half.force == pytest.approx(np.linalg.norm(wrench[:, :3], axis=1).max(), rel=1e-4)
    assert 0.05 < half.strain < 1.0
    assert half.eigenvalue == pytest.approx(1.0, abs=0.2)
    predictor.destroy()


def test_a_gripper_that_is_off_shows_on_the_way_back_as_well(coarser_scene: Path) -> None:
    """The tangent along a pull and back, half of which is computed, against a gripper that is really off."""
    scene = Scene.read(coarser_scene)
    predictor = PullPredictor(scene, 0, MPI.COMM_SELF)
    assert scene.limits is not None
    action, anchors, step = moves(scene)[0].action(scene.limits), frozenset("34"), 1e-4
    (tangent,) = predictor.differentiate([(anchors, action)])
    assert tangent is not None
    number = next(i for i, probe in enumerate(tangent.wanted.probes) if probe.effect.name == "grip")
    found = tangent.found.probes[number]["y"]
    off = np.where((action.steps > 0)[:, None], [0.0, step, 0.0], 0.0)
    more, less = (
        predictor.forward().predict(anchors, [replace(action, translation=action.translation + sign * off)]).positions
        for sign in (1, -1)
    )
    np.testing.assert_allclose(found, (more - less) / (2 * step), atol=2e-3)
    assert np.abs(found[-1]).max() > 0.1
    assert found.shape == (len(action), len(scene.fiducials), 3)
    np.testing.assert_array_equal(found[1], found[-2])
    predictor.destroy()


def test_a_body_that_has_buckled_is_told(coarser_scene: Path) -> None:
    """Pushed at its corner the slab bends aside on a path that never gets soft; pulled and lifted it does not."""
    scene = on_finer_mesh(coarser_scene)
    assert scene.limits is not None
    limits = replace(scene.limits, directions={"in": (-1.0, 0.0, 0.0), "out": (1.0, 0.0, 0.0), "up": (0.0, 1.0, 0.0)})
    predictor = PullPredictor(scene, 0, MPI.COMM_SELF)
    found = {}
    for direction in limits.directions:
        action = Move("III", direction, 0.008).action(limits)
        found[direction] = predicted(predictor.forward(), frozenset("34"), action, detailed=True)
    assert found["in"].eigenvalue == 0.0
    assert found["out"].eigenvalue > 0.9
    assert found["up"].eigenvalue > 0.9
    # Pushed in its plane it has left it, by millimetres.
    aside = found["in"].positions[4, :, 1].mean() - scene.rest[:, 1].mean()
    assert abs(aside) > 3e-3
    assert abs(found["out"].positions[4, :, 1].mean() - scene.rest[:, 1].mean()) < 1e-3
    predictor.destroy()
