"""Courses in time: amounts between knots, what they do to forms, motions and pictures, and scores without new solves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.comparison.courses import knots, variant_in_time
from bcid.comparison.predictor import Predictor
from bcid.comparison.state import State
from bcid.comparison.variants import Variant, all_variants
from bcid.forms import check_effect, effects
from bcid.forms.course import Course, course_of, in_time
from bcid.forms.effect_trial import EffectTrial
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.sensitivity import Probe, Sensitivity, Wanted
from bcid.forms.simulate import simulate
from bcid.forms.solver.equilibrium import Settings
from bcid.measurement import Action
from bcid.scene import Level, Scene

Array = NDArray[np.float64]
TIMES = (0.0, 1.5, 4.0)
KINDS = ("active_stress", "grasp_slip", "camera_offset")


def course(effect: Effect) -> Course:
    found = course_of(effect)
    assert found is not None
    return found


# -- one effect
# ------------------------------------------------------------------------------------------------------------------


def test_amounts_go_straight_from_knot_to_knot_or_jump() -> None:
    stress = effects.effect("active_stress")
    values = {"amplitude_1": -100.0, "amplitude_2": 200.0, "amplitude_3": 50.0, "angle": 30.0}
    straight, steps = in_time(stress, TIMES), in_time(stress, TIMES, stepwise=True)
    at = (-1.0, 0.0, 0.5, 1.5, 1.5001, 3.0, 4.0, 9.0)
    found = [course(straight)(t, values)["amplitude"] for t in at]
    assert found == pytest.approx([-100, -100, 0, 200, 199.994, 110, 50, 50], abs=1e-9)
    assert [course(steps)(t, values)["amplitude"] for t in at] == [-100, -100, -100, 200, 200, 200, 50, 50]
    acting = course(straight)(0.5, values)
    assert (acting["angle"], acting["period"]) == (30.0, 0.0)
    for one in (straight, steps):
        assert course(one).weights(np.linspace(-1, 6, 50)).sum(axis=1) == pytest.approx(1.0)
    assert in_time(stress, list(TIMES)) == straight != steps
    assert straight.name == "active_stress_in_time"
    assert [p.name for p in straight.amounts] == ["amplitude_1", "amplitude_2", "amplitude_3"]
    assert {(p.unit, p.lower, p.upper, p.scale, p.neutral) for p in straight.amounts} == {("Pa", -1e7, 1e7, 500.0, 0.0)}
    assert Term(straight, values).free == tuple(f"active_stress_in_time.{name}" for name in values)


@pytest.mark.parametrize("check", [c for c in check_effect.CHECKS if c not in ("definition", "units")])
@pytest.mark.parametrize("name", [*KINDS, "compressibility"])
def test_an_effect_in_time_keeps_the_rules_of_effects(trials: dict[str, EffectTrial], name: str, check: str) -> None:
    """But for the one of units: the knots are at times of one measurement."""
    finding = check_effect.run(check, trials[name])
    assert finding.ok, finding


@pytest.fixture(scope="module")
def trials() -> Iterator[dict[str, EffectTrial]]:
    # At any time between two knots both act.
    made = {name: EffectTrial(in_time(effects.effect(name), (-1.0, 5.0))) for name in (*KINDS, "compressibility")}
    yield made
    for one in made.values():
        one.destroy()


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("soft_anchor", "no course leads from there"),
        ("viscosity", "remembers earlier steps"),
        ("support_friction", "remembers earlier steps"),
        ("marker_fault", r"begins at a frame of its own \(onset\)"),
    ],
)
def test_what_cannot_follow_a_course_is_refused_in_words(name: str, reason: str) -> None:
    with pytest.raises(InputError, match=f"^{name}: .*{reason}"):
        in_time(effects.effect(name), TIMES)


@pytest.mark.parametrize("times", [(1.0,), (0.0, 2.0, 2.0), (0.0, float("nan"))])
def test_times_that_do_not_rise_are_refused(times: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"gravity: .*(two knots|must rise)"):
        in_time(effects.effect("gravity"), times)
    with pytest.raises(InputError, match="follow a course already"):
        in_time(in_time(effects.effect("gravity"), TIMES), TIMES)


@pytest.mark.parametrize(
    ("name", "values"), [("grasp_slip", {"lag": (0.0, 0.3, 0.6)}), ("time_lag", {"seconds": (0.2, 0.5, 0.1)})]
)
def test_the_gripper_does_at_each_step_what_the_amounts_say_then(
    name: str, values: dict[str, tuple[float, ...]]
) -> None:
    """Against one prediction with constant amounts for each frame."""
    constant = effects.effect(name)
    moving = in_time(constant, TIMES)
    numbers = {f"{n}_{k + 1}": v for n, row in values.items() for k, v in enumerate(row)}
    (action,) = EffectTrial(constant).actions
    found = moving.driven(action, numbers)
    assert constant.drive is not None
    for k, time in enumerate(action.clock):
        one = constant.drive(action, dict(course(moving)(float(time), numbers)))
        assert found.translation[k] == pytest.approx(one.translation[k])
        assert found.rotation[k] == pytest.approx(one.rotation[k])
        assert found.loads["top"][k] == pytest.approx(one.loads["top"][k])


# -- sensitivities
# ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("active_stress", {"amplitude": (400.0, -300.0, 200.0), "angle": 20.0}),
        ("grasp_slip", {"lag": (0.1, 0.2, 0.4)}),
    ],
)
def test_sensitivities_are_difference_quotients(name: str, values: dict[str, float | tuple[float, ...]]) -> None:
    effect = in_time(effects.effect(name), TIMES)
    numbers: dict[str, float] = {}
    for key, value in values.items():
        numbers |= {f"{key}_{k + 1}": v for k, v in enumerate(value)} if isinstance(value, tuple) else {key: value}
    with EffectTrial(effect) as trial:
        forward = trial.forward(trial.model(numbers))
        term = forward.model.terms[0]
        prediction = trial.predicted(forward)
        found = (
            Sensitivity(forward)
            .of(["left"], trial.actions, prediction, Wanted((Probe(term, tuple(numbers)),)))
            .probes[0]
        )
        for p in effect.parameters:
            seen = []
            for sign in (1.0, -1.0):
                forward.set_model(trial.model({**numbers, p.name: numbers[p.name] + sign * 1e-2 * p.scale}))
                seen.append(trial.positions(forward))
            quotient = (seen[0] - seen[1]) / (2e-2 * p.scale)
            assert np.abs(found[p.name] - quotient).max() < 2e-3 * np.abs(quotient).max(), p.name


# -- scores without new solves
# ------------------------------------------------------------------------------------------------------------------


def pulls(steps: int = 6) -> list[Action]:
    """Two pulls, one after the other on the same clock."""
    unturned, count = np.tile([1.0, 0.0, 0.0, 0.0], (steps, 1)), np.arange(steps)
    return [
        Action(
            str(number + 1),
            number * steps + count,
            count,
            grasp,
            0.0015 * count[:, None] * np.array(way, float),
            unturned,
            times=2.0 * (number * steps + count),
        )
        for number, (grasp, way) in enumerate({"I": (1, 0, 0), "II": (0, 1, 0)}.items())
    ]


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    return replace(scene, levels=(Level(2, 0.05), Level(2, 0.025)), noise_sigma=0.2e-3)


@pytest.fixture(scope="module")
def state(slab: Scene) -> Iterator[State]:
    made = simulate(slab, {"1", "3"}, pulls(), level=0, times=2.0 * np.arange(12))
    predictor = Predictor(slab, made, MPI.COMM_SELF, level=1, settings=Settings(rtol=1e-9))
    yield State.of(predictor, Model.of(slab), frozenset({"1", "3"}))
    predictor.destroy()


def variants(state: State, effect: Effect) -> list[Variant]:
    return all_variants(state, [(effect, "")])[effect.name]


@pytest.mark.parametrize("stepwise", [False, True])
@pytest.mark.parametrize("name", KINDS)
def test_a_course_is_scored_from_its_constant_amounts(state: State, name: str, stepwise: bool) -> None:
    """Against the sensitivities of the effect whose amounts follow the course."""
    times, constant = knots(state.predictor.measurement, 4), effects.effect(name)
    steady = [v for v in variants(state, constant) if not v.term.values.get("period")]
    true = variants(state, in_time(constant, times, stepwise))
    assert len(steady) == len(true) > 0
    for one, other in list(zip(steady, true, strict=True))[::9]:
        found = variant_in_time(state, one, times, stepwise)
        assert found.term == other.term
        assert found.amounts == other.amounts
        assert found.sensitivity.shape == (len(state.predictor.data), 4 * len(one.amounts))
        # What changes smoothly with the motion is interpolated between a few steps, what follows a course is not.
        assert np.abs(found.sensitivity - other.sensitivity).max() < 0.02 * np.abs(other.sensitivity).max()


def test_knots_are_spread_over_what_was_seen(state: State) -> None:
    measurement = state.predictor.measurement
    assert knots(measurement, 4) == pytest.approx([0.0, 22 / 3, 44 / 3, 22.0])
    assert len(knots(measurement)) == 6, "two frames for each"
    blind = measurement.data.copy(deep=True)
    blind["position"][{"frame": slice(6, None)}] = np.nan
    assert knots(replace(measurement, data=blind)) == pytest.approx([0.0, 5.0, 10.0])
    with pytest.raises(InputError, match="seen at 12 different times, and 1 knots"):
        knots(measurement, 1)
