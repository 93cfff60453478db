"""What looks wrong in a measurement is named, with what to do; what is only odd or real passes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bcid import Measurement, Scene
from bcid.base.errors import InputError
from bcid.forms.simulate import recorded
from bcid.measurement import Action
from validation.reliability import slips

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.filterwarnings("error")


@cache
def slab() -> Scene:
    return Scene.read(ROOT / "examples/scenes/slab.toml")


@cache
def sound() -> Measurement:
    return Measurement.read(ROOT / "examples/measurements/hidden-d")


def refused(change: slips.Change) -> str:
    with pytest.raises(InputError) as error:
        change(sound()).check(slab())
    return str(error.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (slips.turned((1, 0, 2)), "x and y look swapped"),
        (slips.turned((0, 1, 2), (1, -1, 1)), "y looks reversed"),
        (slips.turned((1, 2, 0)), "columns x, y, z hold y, z, x of the scene"),
        (slips.scaled(1e3), "all positions look 1000 times too large: check length_unit (it is 'mm')"),
        (slips.scaled(0.1), "all positions look 10 times too small"),
        (slips.swapped((2, 6)), "fiducials 3 and 7 look swapped"),
        (slips.swapped((2, 6), action=3), "at step 0 of action 4, fiducials 3 and 7 look swapped"),
        (slips.shifted(1), "16 fiducials look as if they had each other's names"),
        (slips.rotated((0.6, 0.0, 0.8), 120.0, (30.0, -20.0, 400.0)), "a frame that is turned by 120 degrees"),
        (slips.coordinate(7, 4, 0, 1e30), "fiducial 5: x = 1e+33 mm is further away than 20 times"),
        (slips.coordinate(7, 4, 0, 1e200), "check the number and its decimal point"),
        (slips.coordinate(14, 1, 0, factor=10.0), "fiducial 2: x = "),
        (slips.pose(4, 1, 1e200), "the gripper's y = 1e+203 mm is more than 20 times"),
        (slips.pose(4, 0, factor=100.0), "gripper (II): x = 800 mm where the steps beside it let expect about 8 mm"),
        (slips.gripper_turned((1, 0, 2)), "in the gripper's poses x and y look swapped"),
        (slips.scaled(1e-3, fiducials=False), "in the gripper's poses all lengths look 1000 times too small"),
    ],
)
def test_a_slip_is_refused_by_its_name(change: slips.Change, said: str) -> None:
    assert said in refused(change)


def test_a_lost_decimal_point_is_given_back() -> None:
    written = float(sound().positions[14, 1, 0]) * 1e3
    assert f"was {written:.6g} mm meant? Check its decimal point" in refused(slips.coordinate(14, 1, 0, factor=10.0))


def test_which_files_are_concerned_is_said() -> None:
    changes = {False: slips.scaled(1e3, gripper=False), True: slips.scaled(1e3)}
    for both, change in changes.items():
        text = refused(change)
        assert "all positions look 1000 times too large" in text
        assert ("the same holds for grasps.csv" if both else "grasps.csv looks right") in text


@pytest.mark.parametrize("name", ["slab-34-complex", "slab-12-semicircle"])
@pytest.mark.parametrize("factor", [1e3, 1e-3, 25.4, 10.0])
def test_another_unit_is_told_by_its_factor(name: str, factor: float) -> None:
    """Not by a smaller one, after which the body would be stretched by the rest."""
    wrong = slips.scaled(factor)(Measurement.read(ROOT / "examples/measurements" / name))
    looks = f"{factor:g} times too large" if factor > 1 else f"{1 / factor:g} times too small"
    with pytest.raises(InputError, match=f"all positions look {looks}: check length_unit"):
        wrong.check(slab())


def test_one_motion_in_several_directions_tells_the_axes_of_the_gripper() -> None:
    wrong = slips.gripper_turned((2, 1, 0))(Measurement.read(ROOT / "examples/measurements/slab-34-complex"))
    [said] = wrong.check(slab())
    assert "in the gripper's poses x and z look swapped" in said


def test_a_point_that_was_taken_for_another_is_said_and_not_refused() -> None:
    said = slips.coordinate(20, 5, 2, float(sound().positions[20, 5, 2]) + 0.047)(sound()).check(slab())
    assert len(said) == 1
    assert "fiducial 6: z = " in said[0]
    assert "check that step, or leave it empty" in said[0]


def test_a_marker_that_is_off_and_a_body_that_sags_or_moves_as_a_whole_pass() -> None:
    positions = sound().positions.copy()
    positions[:, 4] += [0.002, 0.002, -0.001]
    assert slips.changed(sound(), positions).check(slab()) == []
    rest = slab().rest
    # An edge hangs 23 mm below the other.
    sagged = sound().positions - np.outer(0.25 * rest[:, 0], [0.0, 1.0, 0.0])
    assert slips.changed(sound(), sagged).check(slab()) == []
    assert slips.changed(sound(), sound().positions + np.array([0.004, -0.01, 0.003])).check(slab()) == []


def test_a_marker_that_is_far_off_is_said_and_not_refused() -> None:
    positions = sound().positions.copy()
    positions[:, 5] += [0.03, 0.0, 0.023]
    said = " ".join(slips.changed(sound(), positions).check(slab()))
    assert "fiducial 6 is 37" in said
    assert "mm from where its neighbours let expect it: check its place in the scene" in said


def test_fiducials_that_do_not_follow_the_gripper_are_no_slip() -> None:
    still = np.tile(slab().rest, (len(sound().positions), 1, 1))
    noise = np.random.default_rng(0).normal(0.0, 1e-4, still.shape)
    assert slips.changed(sound(), still + noise).check(slab()) == []


def without_noise(change: slips.Change) -> tuple[Scene, Measurement]:
    return replace(slab(), noise_sigma=None), replace(change(sound()), noise_sigma=None)


def test_noise_that_nobody_stated_is_no_slip() -> None:
    """Points that are off by 3 % of the body's size, a third of them not seen."""
    rng = np.random.default_rng(2)

    def rough(seen: Measurement) -> Measurement:
        positions = seen.positions + rng.normal(0, 3e-3, seen.positions.shape)
        positions[rng.random(positions.shape[:2]) < 0.35] = np.nan
        # Sound at rest: else only what is wrong there would be told.
        first = [action.frames[0] for action in seen.actions]
        positions[first] = seen.positions[first]
        return slips.changed(seen, positions)

    for _ in range(10):
        scene, seen = without_noise(rough)
        assert [text for text in seen.check(scene) if "the steps beside it" in text] == []


def test_two_steps_without_a_stated_noise_tell_nothing_of_the_gripper() -> None:
    """What the fiducials do between them may be noise alone."""
    rng = np.random.default_rng(3)

    def still(seen: Measurement) -> Measurement:
        data = seen.data.isel(frame=[0, 1])
        first = data["position"].values[:1]
        data["position"] = (data["position"].dims, first + rng.normal(0, 3e-4, (2, *first.shape[1:])))
        return replace(seen, data=data)

    for _ in range(20):
        scene, seen = without_noise(still)
        assert seen.check(scene) == []


def test_markers_that_were_not_seen_are_no_slip() -> None:
    positions = sound().positions.copy()
    positions[:, ::3] = np.nan
    positions[5:9] = np.nan
    assert slips.changed(sound(), positions).check(slab()) == []
    positions[:, 1:] = np.nan
    positions[:, 1] = sound().positions[:, 1]
    assert slips.changed(sound(), positions).check(slab()) == []


def test_coordinates_that_are_zero_do_not_look_too_small() -> None:
    flat = replace(slab(), fiducials={name: (x, 0.0, z) for name, (x, _, z) in slab().fiducials.items()})
    seen = sound().positions * [1.0, 0.0, 1.0]
    assert slips.changed(sound(), seen).check(flat) == []


def test_two_of_many_markers_are_found() -> None:
    rng = np.random.default_rng(0)
    places = rng.random((400, 3)) * [0.08, 0.0, 0.1] + [0.0, 0.01, 0.0]
    many = replace(slab(), fiducials={str(i): (float(x), float(y), float(z)) for i, (x, y, z) in enumerate(places)})
    still = Action("1", np.arange(2), np.arange(2), "", np.zeros((2, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    seen = recorded(many, [still], np.tile(places, (2, 1, 1)), 2e-4, rng)
    assert seen.check(many) == []
    with pytest.raises(InputError, match="fiducials 3 and 9 look swapped"):
        slips.swapped((3, 9))(seen).check(many)


def test_remarks_of_the_reader_stand_first() -> None:
    assert replace(sound(), remarks=("it was read upside down",)).check(slab()) == ["it was read upside down"]


def test_gaps_beside_a_step_are_bridged() -> None:
    positions = sound().positions.copy()
    positions[[13, 15]] = np.nan
    gap = slips.changed(sound(), positions)
    assert gap.check(slab()) == []
    with pytest.raises(InputError, match=r"fiducial 2: x = .* Check its decimal point"):
        slips.coordinate(14, 1, 0, factor=10.0)(gap).check(slab())
