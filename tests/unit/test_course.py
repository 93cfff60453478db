"""Courses in time: amounts between knots, what they do to forms, motions and pictures, and scores without new solves."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import runs
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.stats import chi2

from bcid.base.errors import InputError
from bcid.forms import check_effect, effect_trial, effects
from bcid.forms.course import Course, course_of, in_time
from bcid.forms.effect_trial import EffectTrial
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.probes import Probe, SensitivityRequest
from bcid.forms.sensitivity import Sensitivity
from bcid.forms.simulate import simulate
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.evidence import log_gains
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.results.common_rows import ParameterRow
from bcid.results.diagnosis_record import SelectedEffect, TimeHistory
from bcid.results.diagnosis_words import effect_text, history_text
from bcid.scene import Level, Scene
from bcid.search.answer.source import Source, _stored_model, stored_effect
from bcid.search.answer.written_term import parsed_term
from bcid.search.fitting.courses import knots, seen, time_histories, variant_in_time
from bcid.search.fitting.fit import Fit
from bcid.search.fitting.parameter_priors import one_sided, visible
from bcid.search.fitting.ranking import dormant
from bcid.search.fitting.state import State
from bcid.search.fitting.variants import Variant, all_variants, amounts
from validation.accuracy.courses import Case, missed

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
    # Ranking reads off the path what one number for all times shows.
    assert moving.retimed is None
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
            .of(["left"], trial.actions, prediction, SensitivityRequest((Probe(term, tuple(numbers)),)))
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


@pytest.mark.parametrize("swings", [False, True])
def test_evidence_decides_whether_a_course_pays(state: State, swings: bool) -> None:
    """A constant stress is better told by one number, one that swings by a number for each knot."""
    steady = next(v for v in variants(state, effects.effect("active_stress")) if not v.term.values["period"])
    moving = variant_in_time(state, steady, knots(state.predictor.measurement, 4))
    amplitudes = 600.0 * (np.array([1.0, -1.0, 1.0, -1.0]) if swings else np.ones(4))
    noise = np.random.default_rng(4).normal(size=len(state.predictor.data))
    residual = noise + moving.sensitivity @ amplitudes

    def gain(one: Variant) -> float:
        widths = visible(math.inf)[:, None] * np.array([c.scale for c in one.amounts])
        return float(log_gains(residual, one.sensitivity[:, None], widths, one_sided(one.amounts))[0])

    better, worse = (moving, steady) if swings else (steady, moving)
    assert gain(better) > max(gain(worse) + 2.0, 10.0)


def test_constant_amounts_are_not_missing_beside_their_course(state: State) -> None:
    stress, gravity = effects.effect("active_stress"), effects.effect("gravity")
    values = {f"amplitude_{k}": 0.0 for k in (1, 2, 3)}
    moving = replace(state, model=state.model + Term(in_time(stress, TIMES), values))
    assert dormant(state, [stress, gravity])[0] == [(stress, ""), (gravity, "")]
    assert dormant(moving, [stress, gravity])[0] == [(gravity, "")]


def test_knots_are_spread_over_what_was_seen(state: State) -> None:
    measurement = state.predictor.measurement
    assert knots(measurement, 4) == pytest.approx([0.0, 22 / 3, 44 / 3, 22.0])
    assert len(knots(measurement)) == 6, "two frames for each"
    blind = measurement.data.copy(deep=True)
    blind["position"][{"frame": slice(6, None)}] = np.nan
    assert knots(replace(measurement, data=blind)) == pytest.approx([0.0, 5.0, 10.0])
    with pytest.raises(InputError, match="seen at 12 different times, and 1 knots"):
        knots(measurement, 1)
    steps = knots(measurement, 4, stepwise=True)
    assert steps == pytest.approx([0.0, 5.0, 11.0, 17.0]), "each between two frames"


# -- a hidden course
# ------------------------------------------------------------------------------------------------------------------


def test_a_course_is_found_where_constant_amounts_fail() -> None:
    """A stress that swings, measured on a finer mesh; `validation/accuracy/courses.py` has a grip and a camera."""
    case = Case.of("active_stress")
    constant, moving = case.fitted(case.effect), case.fitted(case.in_time())
    assert not constant.rungs[-1].adequacy.adequate
    last = moving.rungs[-1]
    assert last.adequacy.adequate
    assert last.state.rms < 1.2 * case.scene.noise_sigma  # type: ignore[operator]
    off = missed(case, moving)
    assert np.abs(off).max() < 3
    assert np.sqrt(np.mean(off**2)) < 1.6


# -- as users write it, and as it is told
# ------------------------------------------------------------------------------------------------------------------


def scene_with(scene: Scene, **table: object) -> Scene:
    return replace(scene, effects={"active_stress": table})


def test_a_scene_may_have_a_course(slab: Scene) -> None:
    straight = scene_with(
        slab, course=["0 s", "2 s", "1 min"], amplitude=["0 Pa", "0.3 kPa", "-300 Pa"], angle="30 deg"
    )
    (term,) = Model.of(straight).terms
    assert term.effect == in_time(effects.effect("active_stress"), (0.0, 2.0, 60.0))
    assert term.values == {"amplitude_1": 0.0, "amplitude_2": 300.0, "amplitude_3": -300.0, "angle": 30.0}
    (term,) = Model.of(scene_with(slab, stepwise=["0 s", "2 s"], amplitude="5 Pa")).terms
    assert term.effect == in_time(effects.effect("active_stress"), (0.0, 2.0), stepwise=True)
    assert term.values == {"amplitude_1": 5.0, "amplitude_2": 5.0, "angle": 0.0}


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        (
            {"amplitude": ["0 Pa", "1 Pa"]},
            'amplitude is a list: add the times of its values, as course = ["0 s", "10 s"]',
        ),
        ({"course": "8", "amplitude": "1 Pa"}, "course = '8': expected a list of times"),
        ({"course": ["0 s", "5 mm"], "amplitude": "1 Pa"}, "course: unit 'mm' cannot be used here"),
        ({"course": ["0 s", "5 s"], "amplitude": ["1 Pa"]}, "amplitude: found 1 values for 2 times; give one for each"),
        ({"course": ["0 s", "5 s"], "amplitude": ["1 Pa", "x"]}, "amplitude_2: .*x"),
        ({"course": ["0 s", "5 s"]}, "amplitude is missing: give 2 values"),
        ({"course": ["5 s", "0 s"], "amplitude": "1 Pa"}, "must rise from knot to knot, found 5, 0 s"),
        ({"course": ["5 s", "9 s"], "stepwise": ["5 s", "9 s"], "amplitude": "1 Pa"}, "exclude each other"),
        ({"course": ["0 s", "5 s"], "amplitude": "1 Pa", "period": "2 s"}, "unknown parameter 'period'"),
    ],
)
def test_a_wrong_course_is_told_in_words(slab: Scene, table: dict[str, object], problem: str) -> None:
    with pytest.raises(InputError, match=f"effects.active_stress.*{problem.replace('[', '.').replace(']', '.')}"):
        Model.of(scene_with(slab, **table))


@pytest.fixture(scope="module")
def source(slab: Scene, state: State) -> Source:
    measurement = state.predictor.measurement
    return Source(Path("s"), Path("m"), slab, measurement, Model.of(slab), frozenset({"1", "3"}))


def test_a_course_is_asked_for_in_a_line(source: Source) -> None:
    term = parsed_term("active_stress: course = 4, amplitude = 0.2 kPa, amplitude_3 = -10 Pa, angle = 30", source)
    assert term.effect == in_time(effects.effect("active_stress"), knots(source.measurement, 4))
    amplitudes = {"amplitude_1": 200.0, "amplitude_2": 200.0, "amplitude_3": -10.0, "amplitude_4": 200.0}
    assert term.values == amplitudes | {"angle": 30.0}
    steps = parsed_term("grasp_slip: stepwise = 3", source)
    assert steps.effect == in_time(effects.effect("grasp_slip"), knots(source.measurement, 3, True), True)
    assert set(steps.values.values()) == {0.0}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("gravity: course = 7", "two frames, at different times, for at most 6 knots"),
        ("gravity: course = 1", "a whole number from 2 on"),
        ("gravity: course = many", "a whole number from 2 on"),
        ("gravity: course = 3, stepwise = 3", "exclude each other"),
        ("gravity: course = 3, mass = 1", "has no parameter 'mass'; known: weight$"),
        ("viscosity: course = 3", "remembers earlier steps"),
    ],
)
def test_a_line_that_asks_for_no_course_is_told_in_words(source: Source, text: str, problem: str) -> None:
    with pytest.raises(InputError, match=f"--add {text.split(':')[0]}.*{problem}"):
        parsed_term(text, source)


def test_a_model_is_stored_with_its_courses(source: Source) -> None:
    term = parsed_term("grasp_slip: stepwise = 3, lag = 0.1", source)
    entry = {**stored_effect(term.effect), "place": "", "values": dict(term.values)}
    assert entry["effect"] == "grasp_slip"
    stored = {"law": dict(source.model.values), "effects": [entry], "anchored": ["1"], "free": list(term.free)}
    again = _stored_model(source, stored, Path("run"))["model"]
    assert again.terms == (term,)
    moved = [
        replace(
            source,
            model=source.model
            + Term(in_time(effects.effect("gravity"), times), dict.fromkeys(("weight_1", "weight_2"), 1.0)),
        )
        for times in ((0.0, 1.0), (0.0, 2.0))
    ]
    assert moved[0].inputs({}) != moved[1].inputs({}), "a run does not go on with other knots"


def test_a_course_is_told_by_its_ends() -> None:
    moving = in_time(effects.effect("camera_offset"), (0.0, 10.0))
    values = {p.name: p.neutral or 0.0 for p in moving.parameters} | {"tx_1": -1e-3, "tx_2": 2e-3}
    numbers = {p.name: ParameterRow(value=values[p.name], stderr=1e-4, unit=p.unit) for p in moving.parameters}
    row = TimeHistory(
        effect="camera_offset",
        place="",
        amount="tx",
        unit="m",
        stepwise=False,
        times=(0.0, 10.0),
        values=(-1e-3, 2e-3),
        stderr=(1e-4, 1e-4),
    )
    text = effect_text(SelectedEffect(effect=moving.name, place="", parameters=numbers), [row])
    assert "tx from −1.00 ± 0.10 mm (at 0 s) to 2.00 ± 0.10 mm (at 10 s)" in text
    assert "tx_1" not in text


def fit_of(values: Sequence[float], covariance: Array) -> Fit:
    """An active stress whose amplitudes were fitted."""
    moving = in_time(effects.effect("active_stress"), np.arange(len(values)))
    numbers = {f"amplitude_{k + 1}": float(v) for k, v in enumerate(values)}
    term = Term(moving, numbers)
    model = Model.of(effect_trial.scene()) + term
    state: Any = SimpleNamespace(model=model)
    return Fit(state, tuple(amounts(term, list(numbers))), covariance, np.zeros((0, len(values))), (), 0)


def test_values_that_miss_alike_tell_that_they_change() -> None:
    """A common error of 100 Pa does not hide a swing of 60 Pa that is known to 5 Pa."""
    swing, common, own = [-30.0, 30.0, 0.0], np.full((3, 3), 1e4), 25.0 * np.eye(3)
    (row,) = time_histories(fit_of(swing, common + own))
    assert row.to_json() == {
        "effect": "active_stress",
        "place": "",
        "amount": "amplitude",
        "unit": "Pa",
        "stepwise": False,
        "times": [0.0, 1.0, 2.0],
        "values": swing,
        "stderr": [pytest.approx(math.sqrt(10025))] * 3,
        "stderr_from_mean": [pytest.approx(5 * math.sqrt(2 / 3))] * 3,
        # The squares of what the values are from their mean, in units of 5 Pa.
        "p_constant": pytest.approx(chi2.sf(2 * 36, 2), rel=1e-6),
        "changes": True,
    }
    assert (
        history_text(row) == "active_stress: amplitude swings between −30 and 30 Pa (p < 0.0001 that it is constant)."
    )
    steady = fit_of([290.0, 300.0, 305.0], common + own)
    (row,) = time_histories(steady)
    assert "may as well be constant" in history_text(row)
    assert seen(steady, steady.state.model.terms[0], 0.1)
    nothing = fit_of([5.0, -5.0, 0.0], common + own)
    assert not seen(nothing, nothing.state.model.terms[0], 0.1)
    (row,) = time_histories(replace(nothing, coordinates=(), covariance=np.zeros((0, 0))))
    assert (row.stderr, row.stderr_from_mean, row.p_constant) == ((None,) * 3, (None,) * 3, None)
    assert history_text(row).endswith("amplitude: whether it changes with time is not told.")
    blind = fit_of([5.0, -5.0, 0.0], np.diag([1e200] * 3))
    (row,) = time_histories(blind)
    assert (row.stderr, row.p_constant) == ((None,) * 3, None)
    angle = {"angle": ParameterRow(value=0.0, stderr=None, unit="deg")}
    one = SelectedEffect(effect="active_stress_in_time", place="", parameters=angle)
    assert effect_text(one, [row]) == "active_stress_in_time: amplitude cannot be told, angle = 0 deg"


@pytest.mark.parametrize("stepwise", [False, True])
def test_a_course_is_drawn_with_its_band(stepwise: bool) -> None:
    pytest.importorskip("matplotlib")
    from bcid.report.time_charts import course_chart

    row = {"effect": "camera_offset", "place": "", "amount": "tx", "unit": "m", "stepwise": stepwise}
    row |= {"times": [0.0, 10.0], "values": [-1e-3, 2e-3], "stderr": [1e-4, None], "stderr_from_mean": [2e-5, 2e-5]}
    figure = course_chart([TimeHistory.from_json(row)] * 2)
    assert [axes.get_ylabel() for axes in figure.axes] == 2 * ["camera offset\ntx (mm)"]
    line = figure.axes[0].lines[0]
    assert list(line.get_ydata())[:2] == pytest.approx([-1.0, 2.0])
    assert line.get_drawstyle() == ("steps-post" if stepwise else "default")
    band, inner = figure.axes[0].collections
    if not stepwise:
        apart = inner.get_paths()[0].vertices
        assert np.ptp(apart[apart[:, 0] == 10.0, 1]) == pytest.approx(2 * 1.96 * 0.02, rel=1e-3)
        known = band.get_paths()[0].vertices
        assert np.ptp(known[known[:, 0] == 0.0, 1]) == pytest.approx(2 * 1.96 * 0.1, rel=1e-3)


def test_a_report_has_a_figure_of_courses_where_there_are_any(tmp_path: Path) -> None:
    from bcid.report.found import Found
    from bcid.report.gallery import drawings
    from bcid.report.verdict import verdict

    folder = runs.explained(tmp_path / "run")
    assert "time-histories" not in {one.name for one in drawings(Found.read(folder))}
    diagnosis = json.loads((folder / "diagnosis.json").read_text())
    row = {"effect": "gravity", "place": "", "amount": "weight", "unit": "N/m^3", "stepwise": False}
    diagnosis["time_histories"] = [row | {"times": [0.0, 1.0], "values": [1.0, 2.0], "stderr": [None, None]}]
    diagnosis["selected_effects"] = [{"effect": "gravity_in_time", "place": "", "parameters": {}}]
    runs.rewrite(folder, "diagnosis.json", json.dumps(diagnosis))
    assert ("gravity: weight", "1 to 2 N/m^3") in verdict(Found.read(folder)).numbers
    (found,) = (one for one in drawings(Found.read(folder)) if one.name == "time-histories")
    assert found.draw().axes[0].get_ylabel() == "gravity\nweight (N/m^3)"
