"""What must not be taken for a missing effect: wrong anchors, a coarse mesh, unfitted numbers, a marker that jumped.

A slab is measured on a mesh of 12.5 or 25 mm and compared on one of 75 mm, which 25 mm say the error of.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from verify.problems import move

from bcid.base.errors import InputError
from bcid.base.options import ExplainOptions, IdentifyOptions
from bcid.forms import effects
from bcid.forms.forward import Forward, Prediction
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.responses import Responses
from bcid.forms.simulate import recorded, simulate
from bcid.forms.solver.equilibrium import Settings
from bcid.forms.solver.status import Status
from bcid.inference.continuation import truncate_to_converged
from bcid.inference.mesh_error import MeshError
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Action, Measurement
from bcid.predict.mesh_ladder import mesh_error
from bcid.predict.predictor import Predictor
from bcid.scene import Level, Scene
from bcid.search.answer.adequacy import judge
from bcid.search.answer.explanation import Explanation, explained, explains
from bcid.search.answer.separate import separating_pulls
from bcid.search.coarse_search import CoarseSearch
from bcid.search.explain import explain
from bcid.search.fitting import fitted_hypothesis
from bcid.search.fitting.buckled_frames import buckled, leave_out
from bcid.search.fitting.fit import Fit, columns, coordinates, fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis, fitted_beside, promoted, refit
from bcid.search.fitting.parameter_priors import of_state
from bcid.search.fitting.ranking import rank
from bcid.search.fitting.state import FEW_STEPS, State, in_few_steps
from bcid.search.fitting.variants import _meanwhile
from bcid.search.hypothesis_table import HypothesisTable, TangentEvidence
from bcid.search.identify import identify
from validation.synthetic import outside

ANCHORED = frozenset({"1", "3"})
HEAVY = frozenset({"3", "4"})
NOISE = 0.2e-3
WHOLE: Any = Forward.predict
STEPS = 5
FEW = ("gravity", "fibres", "grasp_slip", "stiffness_gradient", "marker_fault", "soft_anchor", "strain_stiffening")


@pytest.fixture(scope="module", autouse=True)
def coarse() -> Iterator[None]:
    """Coarser meshes than are chosen, of one degree."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bcid.predict.predictor.pair", lambda *_: (Level(2, 0.075), Level(2, 0.025)))
        yield


@pytest.fixture(scope="module")
def eight(project: Path) -> Scene:
    """With all of its patches."""
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    levels = tuple(Level(2, size) for size in (0.05, 0.025, 0.0125))
    return replace(scene, levels=levels, noise_sigma=NOISE)


@pytest.fixture(scope="module")
def slab(eight: Scene) -> Scene:
    """Five patches have 32 sets: enough for wrong ones."""
    return replace(eight, patches={name: eight.patches[name] for name in "12347"})


def pulls() -> list[Action]:
    """Three pulls by 10 mm, each at another grasp and in another direction."""
    unturned = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1))
    steps = np.arange(STEPS)
    found = []
    for number, (grasp, way) in enumerate({"I": (1, 0, 0), "II": (0, 1, 0), "III": (1, 0, -1)}.items()):
        path = 0.0025 * steps[:, None] * np.array(way, float)
        found.append(Action(str(number + 1), number * STEPS + steps, steps, grasp, path, unturned))
    return found


@pytest.fixture(scope="module")
def plain(slab: Scene) -> Measurement:
    return simulate(slab, ANCHORED, pulls(), level=2)


@pytest.fixture(scope="module")
def heavy(slab: Scene) -> Measurement:
    """Of a slab with a weight, held by two patches."""
    model = Model.of(slab) + Term(effects.effect("gravity"), {"weight": 800.0})
    return simulate(slab, HEAVY, pulls(), level=2, model=model)


@pytest.fixture(scope="module")
def predictor(slab: Scene, plain: Measurement) -> Iterator[Predictor]:
    predictor = Predictor(slab, plain, MPI.COMM_SELF, level=1)
    yield predictor
    predictor.destroy()


def at(predictor: Predictor, anchors: frozenset[str] = ANCHORED, **options: MeshError) -> State:
    """The scene's model with these anchors."""
    return State.of(predictor, Model.of(predictor.scene), anchors, **options)


# -- wrong anchors
# ------------------------------------------------------------------------------------------------------------------


def test_no_effect_makes_up_for_a_wrong_anchor_set(predictor: Predictor) -> None:
    """From the wrong anchors every effect looks significant; none is nearly as likely as with the right ones."""
    wrong = at(predictor, frozenset({"1"}))
    assert not judge(wrong).adequate
    ranking = rank(wrong, effects.catalogue(FEW))
    assert ranking.rows[0].p_value < 1e-6
    right = FittedHypothesis.of(Fit.at(at(predictor)), wrong.model, len(FEW))
    stayed = fitted_beside(wrong, effects.catalogue(FEW), 3)
    assert stayed
    for rival in stayed:
        assert rival.anchors == wrong.anchors
        assert rival.log < right.log - 100.0, rival.effect


def test_the_loop_finds_the_anchors_and_no_effect(predictor: Predictor) -> None:
    assert judge(at(predictor)).adequate
    found = explain(predictor, ExplainOptions(level=1, only=FEW))
    assert found.verdict == "none"
    assert found.last.state.anchors == ANCHORED


def coarsely(state: State, names: Sequence[str] = (), sets: int = 1, fits: int = 10) -> list[FittedHypothesis]:
    """Sets and effects beside a model as a few steps show them, the likeliest first."""
    return CoarseSearch(in_few_steps(state), state.model, effects.catalogue(names), sets=sets, fits=fits).run().full


def test_a_large_effect_of_which_the_tangent_tells_little_is_fitted(slab: Scene, heavy: Measurement) -> None:
    predictor = Predictor(slab, heavy, MPI.COMM_SELF, level=1)
    state = at(predictor, HEAVY)
    found = coarsely(state, FEW)
    predictor.destroy()
    assert found[0].names == ("gravity",)
    assert () in {rival.names for rival in found}


def test_a_large_time_lag_is_promised_what_it_shows(predictor: Predictor) -> None:
    """Pulls that begin later than they were told to: the tangent at no lag would have the markers move backwards at first."""
    state = at(predictor, mesh=MeshError.unknown(predictor.data.mask.shape))
    late = Term("time_lag", {"seconds": 2.5})
    moved = predictor.predict(state.model + late, ANCHORED).positions - state.prediction.positions
    shown = _meanwhile(state, late, 2.5)
    assert np.sqrt(np.mean((shown - moved) ** 2)) < 0.05 * np.sqrt(np.mean(moved**2))


def test_an_effect_that_a_few_steps_hide_is_found_in_all(slab: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """They may miss it, or the errors of another set may cover it: all steps are asked before nothing is said to be known."""
    run = CoarseSearch.run

    def blind(self: CoarseSearch) -> HypothesisTable:
        self.effects = {}
        return run(self)

    monkeypatch.setattr(CoarseSearch, "run", blind)
    fault = Term("marker_fault", {"x": 0.005, "y": 0.0, "z": 0.001, "onset": 0.0}, place=slab.fiducial_names[4])
    seen = simulate(slab, HEAVY, pulls(), level=2, model=Model.of(slab) + fault)
    predictor = Predictor(slab, seen, MPI.COMM_SELF, level=1)
    found = explain(predictor, ExplainOptions(level=1, only=("gravity", "marker_fault")))
    predictor.destroy()
    assert found.verdict == "marker_fault"
    assert found.last.state.anchors == HEAVY


def test_what_is_believed_most_was_fitted_to_all_steps(predictor: Predictor, monkeypatch: pytest.MonkeyPatch) -> None:
    """However much a few steps promise of an effect or a set, and of others that rest on the same."""
    run = CoarseSearch.run

    def promising(self: CoarseSearch) -> HypothesisTable:
        self.effects = {}
        table = run(self)
        most = max(rival.evidence.plain for rival in table.full)
        for place, rival in enumerate(r for r in table.full if r.names == self.names):
            evidence = most + 40.0 - 3.0 * place
            table.tangents[rival.hypothesis] = TangentEvidence(effects={"fibres": evidence}, known=self.among)
        return replace(table)

    monkeypatch.setattr(CoarseSearch, "run", promising)
    found = explain(predictor, ExplainOptions(level=1, only=("gravity", "fibres")))
    assert found.verdict == "none"
    assert found.odds.best in {told for rival in found.rivals for told in rival.logs}
    # Others that rest on the same promise are doubted with those that broke it.
    assert sum(rival.names == ("fibres",) for rival in found.rivals) <= 4
    assert found.odds.verdicts["none"] > 0.3


def test_anchors_and_effects_are_rivals(slab: Scene) -> None:
    """A gripper that slips makes the body seem to be held in more places; with these, no effect explains what is seen."""
    anchored, slip = frozenset({"2", "3"}), Term(effects.effect("grasp_slip"), {"lag": 0.6})
    measurement = simulate(slab, anchored, pulls(), level=2, model=Model.of(slab) + slip)
    predictor = Predictor(slab, measurement, MPI.COMM_SELF, level=1)
    seeming = at(predictor, frozenset({"1", "2", "3", "4"}))
    assert seeming.chi2 < at(predictor, anchored).chi2
    best = coarsely(seeming, FEW, 24)[0]
    assert (best.names, best.anchors) == (("grasp_slip",), anchored)
    rival = promoted(best, seeming, seeming.model)
    assert rival is not None
    assert rival.complete
    assert FittedHypothesis.of(Fit.at(seeming), seeming.model, len(FEW)).log < rival.log - math.log(20.0)
    assert rival.term.values["lag"] == pytest.approx(0.6, abs=0.05)
    predictor.destroy()


def test_all_sets_are_seen_from_one_that_was_followed(heavy: Measurement, eight: Scene) -> None:
    """The true set is six toggles away from that of all patches, and the plain model fits best with another one."""
    slab = eight
    predictor = Predictor(slab, heavy, MPI.COMM_SELF, level=1)
    thin, _ = predictor.thinned(2, FEW_STEPS)
    everywhere, model = frozenset(slab.patches), Model.of(slab)
    state = State.of(thin, model, everywhere, MeshError.unknown(thin.data.mask.shape))
    assert CoarseSearch(state, model, sets=8).run().sets[0] == HEAVY
    predictor.destroy()


def test_the_error_of_the_mesh_is_that_of_the_numbers_that_fit(heavy: Measurement, slab: Scene) -> None:
    """Begun at a weight far off, whose error of the mesh is another."""
    predictor = Predictor(slab, heavy, MPI.COMM_SELF, level=1)
    base = at(predictor, HEAVY)
    far = base.model + Term(effects.effect("gravity"), {"weight": 2200.0})
    begun = FittedHypothesis.of(fit(State.of(predictor, far, HEAVY), ("gravity.weight",), most=1), base.model, 1)
    found = promoted(begun, base, base.model)
    assert found is not None
    own = mesh_error(predictor, found.fitted.state.model, HEAVY, found.fitted.state.prediction)
    assert found.fitted.state.errors.mesh.rms == pytest.approx(own.rms, rel=0.3)
    assert found.fitted.values["gravity.weight"] == pytest.approx(800.0, rel=0.2)
    predictor.destroy()


def test_what_has_saturated_is_seen_by_all_that_it_does(heavy: Measurement, slab: Scene) -> None:
    """A ball twenty times as stiff as the body: another notable amount shows nothing, and the ball is seen all the same."""
    predictor = Predictor(slab, heavy, MPI.COMM_SELF, level=1)
    ball = {"ratio": 21.0, "cx": 0.05, "cy": 0.005, "cz": 0.05, "radius": 0.03}
    model = Model.of(slab) + Term(effects.effect("inclusion"), ball)
    state = State.of(predictor, model, HEAVY, free=("inclusion.ratio",))
    moved = columns(predictor, model, HEAVY, state.prediction, coordinates(model, state.free))
    assert np.linalg.norm(state.errors.whiten(moved)) * 10 < THRESHOLDS.detection
    assert of_state(state, Model.of(slab)) is not None
    predictor.destroy()


@pytest.mark.parametrize("torn", [0.0, 0.95])
def test_what_tears_begins_when_it_does(slab: Scene, torn: float) -> None:
    """Nothing that is spread over the body and goes on with the motion explains it; and where nothing tears nothing begins."""
    steps = np.arange(13)
    path = 0.001 * steps[:, None] * np.array([1.0, 0.0, 0.0])
    pull = Action("1", steps, steps, "I", path, np.tile([1.0, 0.0, 0.0, 0.0], (13, 1)))
    place = {"cx": 0.045, "cy": 0.005, "cz": 0.025, "width": 0.006, "length": 0.03, "angle": 80.0}
    band = Term(outside.EFFECTS["tear"], {"torn": torn, **place, "onset": 5.5, "ramp": 0.5})
    scene = replace(slab, noise_sigma=0.05e-3)
    seen = simulate(scene, ANCHORED, [pull], level=2, model=Model.of(scene) + band)
    predictor = Predictor(scene, seen, MPI.COMM_SELF, level=1)
    found = at(predictor).evidence()
    assert found.begins is not None
    if torn:
        assert found.missing > 0.99
        assert found.sudden > 0.99
        assert found.begins.by == 6
    else:
        assert found.missing < 0.2
    predictor.destroy()


@pytest.mark.parametrize("steps", [STEPS, 1])
def test_a_glance_looks_at_rest_once_and_at_every_end(slab: Scene, plain: Measurement, steps: int) -> None:
    """Where an action is nothing but one state, that is looked at."""
    measurement = replace(plain, data=plain.data.isel(frame=plain.data["step"].values < steps))
    thin, frames = Predictor(slab, measurement, MPI.COMM_SELF, level=1).thinned(2, Settings())
    assert [len(action) for action in thin.actions] == [min(3, steps)] * 3
    seen = thin.data.mask.any(axis=(1, 2))
    assert list(seen) == ([True, True, True, False, True, True, False, True, True] if steps > 1 else [True] * 3)
    assert np.array_equal(thin.data.measured[seen], measurement.positions[frames][seen])


def test_responses_made_on_the_way_are_those_of_the_states(
    slab: Scene, plain: Measurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No tangent of a state that is asked about is factorised again, and what is told of it is the same."""
    found, factorised = [], []
    for made in (True, False):
        with monkeypatch.context() as patch:
            if not made:
                patch.setattr(Responses, "worth", lambda *_: False)
            predictor = Predictor(slab, plain, MPI.COMM_SELF, level=1, settings=Settings(rtol=1e-10))
            model = Model.of(slab)
            prediction = predictor.predict(model, ANCHORED, keep=True)
            before = predictor.forward(model).equilibrium.factor.count
            found.append(predictor.disturbances(model, ANCHORED, prediction)[1].kinds)
            factorised.append(predictor.forward(model).equilibrium.factor.count - before)
            predictor.destroy()
    for kept, again in zip(*found, strict=True):
        assert np.abs(kept - again).max() < 1e-6 * np.abs(again).max()
    assert factorised[0] == 0 < factorised[1]


# -- a coarse mesh
# ------------------------------------------------------------------------------------------------------------------


def test_the_error_of_the_mesh_is_not_taken_for_physics(predictor: Predictor) -> None:
    blind = at(predictor, mesh=MeshError.unknown(predictor.data.mask.shape))
    assert not judge(blind).adequate
    assert rank(blind, effects.catalogue(FEW)).rows[0].p_value < 1e-6
    seeing = at(predictor)
    assert judge(seeing).adequate
    assert min(row.p_value for row in rank(seeing, effects.catalogue(FEW)).rows) > 0.01


def test_an_effect_has_no_credit_where_errors_explain_all() -> None:
    """Chi-square may fall by much where it was no larger than errors make it."""

    def fitted(chi2: float) -> Any:
        return SimpleNamespace(state=SimpleNamespace(chi2=chi2, predictor=SimpleNamespace(data=range(1000))))

    assert explained(fitted(900.0), fitted(500.0)) == 0.0
    assert not explains(fitted(900.0), fitted(500.0))
    assert explained(fitted(3000.0), fitted(1100.0)) == pytest.approx(0.95)


# -- numbers that are not fitted
# ------------------------------------------------------------------------------------------------------------------


def test_a_model_off_its_optimum_is_not_ranked(predictor: Predictor) -> None:
    model = Model.of(predictor.scene) + Term(effects.effect("gravity"), {"weight": 2000.0})
    off = State.of(predictor, model, ANCHORED, free=("gravity.weight",))
    with pytest.raises(InputError, match=r"not at its optimum: refitting gravity\.weight alone .* fit it first"):
        rank(off, effects.catalogue(FEW))
    fitted = fit(off, off.free)
    assert rank(fitted.state, effects.catalogue(FEW)).rows


# -- effects that do the same
# ------------------------------------------------------------------------------------------------------------------


def test_effects_that_do_the_same_are_not_told_apart(heavy: Measurement, slab: Scene) -> None:
    predictor = Predictor(slab, heavy, MPI.COMM_SELF, level=1)
    other = replace(effects.effect("gravity"), name="heaviness")
    both = ("gravity", "heaviness")
    ranking = rank(at(predictor, HEAVY), effects.catalogue(both, [other]))
    assert {row.effect: row.confounded_with for row in ranking.rows} == {
        "gravity": ("heaviness",),
        "heaviness": ("gravity",),
    }
    found = explain(predictor, ExplainOptions(level=1, only=both), more=[other])
    assert found.verdict in both
    assert next(name for name in both if name != found.verdict) in found.ambiguous
    rivals = found.rivals
    separating = separating_pulls(*(next(r for r in rivals if r.names == (name,)).fitted.state for name in both))
    assert separating[0].sigmas < 1, "no pull separates two effects that are the same"
    predictor.destroy()


# -- a marker that jumped
# ------------------------------------------------------------------------------------------------------------------


def test_a_marker_that_jumped_is_named(slab: Scene, plain: Measurement) -> None:
    jumped = plain.data.copy(deep=True)
    onset = 8
    jumped["position"][{"frame": slice(onset, None), "fiducial": slab.fiducial_names.index("6"), "axis": 2}] += 2e-3
    predictor = Predictor(slab, replace(plain, data=jumped), MPI.COMM_SELF, level=1)
    found = explain(predictor, ExplainOptions(level=1, only=FEW))
    assert found.verdict == "marker_fault"
    assert found.last.state.anchors == ANCHORED
    (term,) = found.last.state.model.terms
    assert (term.place, term.values["onset"]) == ("6", onset)
    assert term.values["z"] == pytest.approx(2e-3, abs=0.3e-3)
    predictor.destroy()


# -- what made an answer wrong, or "unknown", and certain
# ------------------------------------------------------------------------------------------------------------------


def test_where_anchors_give_the_errors_are_not_those_of_a_rigid_hold(predictor: Predictor) -> None:
    state = at(predictor)
    found = {}
    for name in ("soft_anchor", "gravity"):
        row = rank(state, [effects.effect(name)], strict=False).rows[0]
        found[name] = refit(state, row, state.model, 1)[0].fitted.state
    assert found["soft_anchor"].errors.mesh.about == (found["soft_anchor"].model.name, ANCHORED)
    assert found["gravity"].errors.mesh.about == (state.model.name, ANCHORED)


def test_an_effect_that_still_looks_for_its_place_goes_on(
    predictor: Predictor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As long as its fit has not settled it would be told as less likely than it is."""
    calls: list[str] = []

    def unsettled(start: State, names: Sequence[str], most: int, **rest: Any) -> Fit:
        calls.append(start.model.name)
        return replace(fit(start, names, most=1, **rest), settled=False)

    monkeypatch.setattr(fitted_hypothesis, "fit", unsettled)
    state = at(predictor)
    for name in ("inclusion", "gravity"):
        row = rank(state, [effects.effect(name)], strict=False).rows[0]
        refit(state, replace(row, gain=-math.inf), state.model, 1)
    assert calls == ["neo_hooke + inclusion"] * 2 + ["neo_hooke + gravity"]


def test_an_amount_that_cannot_be_told_from_a_smaller_one_stays_near_none(slab: Scene) -> None:
    """A foundation that is as good as rigid: any larger stiffness does the same, and a fit must not run away with it."""
    scene = replace(slab, support="3")
    stiff = [Model.of(scene) + Term("foundation", {"stiffness": k}, place="sheared") for k in (1e9, 1e6)]
    measured = simulate(scene, {"1"}, pulls(), level=1, model=stiff[0])
    predictor = Predictor(scene, measured, MPI.COMM_SELF, level=1)
    start = State.of(predictor, stiff[1], frozenset("1"), MeshError.unknown(predictor.data.mask.shape))
    found = fit(start, ("foundation(sheared).stiffness",), most=20)
    assert found.values["foundation(sheared).stiffness"] < 3e6
    predictor.destroy()


# -- a body that buckles
# ------------------------------------------------------------------------------------------------------------------


def inverting(self: Forward, anchors: Iterable[str], actions: Sequence[Action], *more: Any, **named: Any) -> Prediction:
    """Predictions of which the true set fails at the end of the last pull, as where an element is turned inside out."""
    found: Prediction = WHOLE(self, anchors, actions, *more, **named)
    trajectories = list(found.trajectories)
    for number, action in enumerate(actions):
        if frozenset(anchors) == ANCHORED and action.name == "3" and np.ptp(action.translation[:, 0]) > 0.0099:
            last = int(action.frames[-1])
            found.positions[last] = np.nan
            (found.states or {}).pop(last, None)
            steps = {
                "steps": len(action) - 1,
                "reason": "an element is turned inside out; action 3 ended at its last step",
            }
            trajectories[number] = replace(trajectories[number], status=Status.INVERTED, **steps)
    return replace(found, trajectories=tuple(trajectories))


def test_that_solves_fail_is_no_evidence(slab: Scene, plain: Measurement, monkeypatch: pytest.MonkeyPatch) -> None:
    """The true set cannot be followed in the last frame: the answer is right, or not certain."""
    monkeypatch.setattr(Forward, "predict", inverting)
    compared = []

    def work(measurement: Measurement) -> Explanation:
        compared.append(measurement)
        return explain(Predictor(slab, measurement, MPI.COMM_SELF, level=1), ExplainOptions(level=1, only=FEW))

    found = truncate_to_converged(plain, work)
    assert found.verdict == "none"
    # A smooth misfit may stand for what the sets that can be followed miss: then these are likely, and none is certain.
    right = found.last.state.anchors == ANCHORED
    assert right or found.held_by < 0.99
    if right:
        (remark,) = compared[-1].remarks
        assert remark.startswith(f"action 3 is compared up to step {STEPS - 2} only")


def test_what_follows_buckling_is_no_evidence(slab: Scene, measurement_folder: Callable[[str], Path]) -> None:
    """In the second action the sheet leaves its plane; to which side, imperfections decide."""
    measurement = Measurement.read(measurement_folder("slab-34-buckles"))
    predictor = Predictor(slab, measurement, MPI.COMM_SELF, level=1)
    anchored, model = frozenset({"3", "4"}), Model.of(slab)
    assert not judge(at(predictor, anchored)).adequate
    (found,) = leave_out(predictor, model, anchored)
    assert (found.action, found.step) == ("2", 6)
    assert found.distance > 10e-3
    state = at(predictor, anchored)
    adequacy = judge(state)
    assert adequacy.adequate
    assert any("two states exist" in finding.text for finding in adequacy.findings)
    assert min(row.p_value for row in rank(state, effects.catalogue(FEW)).rows) > 0.01
    predictor.destroy()


def test_a_body_that_buckles_with_the_true_anchors_alone_is_no_evidence_that_something_is_missing(
    slab: Scene, measurement_folder: Callable[[str], Path]
) -> None:
    """The search begins at a set with which the body does not buckle."""
    measurement = Measurement.read(measurement_folder("slab-34-buckles"))
    start = [frozenset({"2", "7"}), frozenset({"3", "4"})]
    found = identify(slab, measurement, options=IdentifyOptions(exhaustive="no", level=1), start=start)
    assert found.anchored == ("3", "4")
    assert found.discrepancy_probability is not None
    assert found.discrepancy_probability < 0.1


def test_a_body_that_buckles_on_its_way_is_seen_though_it_comes_back(
    slab: Scene, measurement_folder: Callable[[str], Path]
) -> None:
    there = Measurement.read(measurement_folder("slab-34-buckles")).actions[1]
    way = np.concatenate([there.translation, there.translation[-2::-1]])
    unmoved = np.tile(slab.rest, (len(way), 1, 1))
    measurement = recorded(slab, [move(way, there.grasp)], unmoved, 0.0, np.random.default_rng(0))
    predictor = Predictor(slab, measurement, MPI.COMM_SELF, level=1)
    (found,) = buckled(predictor, Model.of(slab), {"3", "4"})
    assert (found.action, found.step) == ("1", 6)
    assert found.distance > 10e-3
    predictor.destroy()


def test_a_body_that_only_bends_is_compared_to_the_end(predictor: Predictor) -> None:
    assert buckled(predictor, Model.of(predictor.scene), ANCHORED) == []
