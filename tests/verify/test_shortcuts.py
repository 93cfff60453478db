"""Every shortcut of the search leaves the answer as it is: against every set in full, by Newton's method, to 1e-10."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from bcid.exploration.moves import limits_of, moves
from bcid.forms import effects
from bcid.forms.force_bumps import bumps
from bcid.forms.forward import Forward, Prediction
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.sensitivity import Sensitivity
from bcid.forms.simulate import simulate
from bcid.forms.solver import equilibrium
from bcid.forms.solver.equilibrium import Equilibrium, Settings
from bcid.forms.solver.factor import Factor
from bcid.forms.solver.status import Status
from bcid.forms.solver.trajectory import Trajectory
from bcid.inference.discrepancy import Evidence
from bcid.inference.knots import knots_of, known_frames
from bcid.inference.nuisances import Nuisances
from bcid.measurement import Action
from bcid.predict.mesh_ladder import mesh_error
from bcid.predict.predictor import Predictor
from bcid.predict.pull_predictor import PullPredictor
from bcid.scene import Level, Scene
from bcid.scene.motions import motion
from bcid.search.fitting.fit import Fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.state import State
from bcid.search.followed_sets import FollowedSets
from bcid.search.hill_climbing import all_candidates
from bcid.search.identify import identify, outliers
from bcid.search.settings import SETTINGS

PATCHES = ("1", "3", "4", "7")
EXACT = Settings(rtol=1e-10)
Anchored = frozenset[str]
Fault = Callable[[pytest.MonkeyPatch], None]


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    """The benchmark slab with four of its patches, on its second level."""
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    return replace(scene, patches={name: scene.patches[name] for name in PATCHES}, levels=scene.levels[1:2])


@pytest.fixture(scope="module", params=[0.0003, 0.020], ids=["clear", "doubtful"])
def measurement(slab: Scene, request: pytest.FixtureRequest) -> Any:
    """With little noise one set is certain; with much, several keep a share of the belief."""
    return simulate(slab, {"3", "4"}, motion("complex", "II"), noise=request.param, random_state=2)


def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tangent of its own for every iteration."""
    reset = Equilibrium.reset

    def careful(self: Equilibrium) -> None:
        reset(self)
        self.careful = True

    monkeypatch.setattr(Equilibrium, "reset", careful)


def fitted(slab: Scene, measurement: Any, settings: Settings | None = None) -> tuple[Predictor, FittedHypothesis]:
    """The true set, compared with all steps."""
    predictor, model = Predictor(slab, measurement, MPI.COMM_SELF, settings=settings), Model.of(slab)
    state = State.of(predictor, model, frozenset({"3", "4"}))
    return predictor, FittedHypothesis.of(Fit.at(state), model, 0)


@pytest.fixture(scope="module")
def everything(slab: Scene, measurement: Any) -> dict[Anchored, Evidence]:
    """Evidence of every set, the long way: each is followed to the end with a tangent of its own for every iteration."""
    with pytest.MonkeyPatch.context() as patch:
        plain(patch)
        predictor, rival = fitted(slab, measurement, EXACT)
        found = {c: rival.fitted.state.of_set(c).evidence() for c in all_candidates(list(PATCHES))}
        predictor.destroy()
    return found


def followed(slab: Scene, measurement: Any) -> FollowedSets:
    """Every set until it has lost."""
    predictor, rival = fitted(slab, measurement)
    found = FollowedSets(predictor, every=True)
    assert next(iter(found.evidences(rival, Model.of(slab)))) == {"3", "4"}
    predictor.destroy()
    return found


def same(found: FollowedSets, everything: dict[Anchored, Evidence], sure: bool) -> None:
    """Evidences of sets that were followed to the end agree, and what was stopped is really worse."""
    best = max(everything, key=lambda c: everything[c].plain)
    assert best == {"3", "4"}
    assert len(found.found) == len(everything)
    assert not found.failed
    logs = {anchors: one.evidence for anchors, one in found.found.items()}
    stopped = sum(not one.complete for one in found.found.values())
    for anchors, one in found.found.items():
        if one.complete:
            behind, exact = (known[best].plain - known[anchors].plain for known in (logs, everything))
            assert behind == pytest.approx(exact, abs=5e-3, rel=0.02)
        else:
            assert one.evidence.plain < logs[best].plain - math.log(SETTINGS.odds * len(everything))
            assert everything[anchors].plain < everything[best].plain - math.log(SETTINGS.odds)
    assert stopped >= 3
    # Where the data say little several sets are followed to the end.
    assert (len(found.found) - stopped == 1) == sure


def test_following_until_lost_answers_as_if_all_had_been_followed(
    slab: Scene, measurement: Any, everything: dict[Anchored, Evidence]
) -> None:
    sure = measurement.noise_sigma < 0.001
    same(followed(slab, measurement), everything, sure)
    logs = sorted(evidence.plain for evidence in everything.values())
    assert (logs[-1] - logs[-2] < 10) != sure, "evidences that are far apart compare little"


def test_a_set_that_fails_is_judged_by_the_frames_before(
    slab: Scene, measurement: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that does as well until then is as likely but for its failure; one that does worse has lost before."""
    predictor, rival = fitted(slab, measurement)
    state, half = rival.fitted.state, len(predictor.data.mask) // 2
    alike, worse = frozenset({"1"}), frozenset({"7"})

    def predict(_self: Forward, anchors: Anchored, _actions: Any, watch: Callable[[int, Any], bool]) -> Prediction:
        positions = state.prediction.positions + (20e-3 if anchors == worse else 0.0)
        last = half if anchors == alike else len(positions)
        for frame in range(last):
            if not watch(frame, positions[frame]):
                positions[frame + 1 :] = np.nan
                return Prediction(positions, (Trajectory(),))
        positions[last:] = np.nan
        status = Status.UNSTABLE if anchors == alike else Status.CONVERGED
        return Prediction(positions, (Trajectory(status, reason="buckles" if anchors == alike else ""),))

    monkeypatch.setattr(Forward, "predict", predict)
    found = FollowedSets(predictor, every=True)
    logs = found.evidences(rival, state.model)
    assert logs[alike].plain == pytest.approx(logs[state.anchors].plain, abs=1e-9)
    assert found.failed == [alike]
    assert found.found[alike].frames.sum() == half
    assert 0 < found.found[worse].frames.sum() < half or measurement.noise_sigma > 0.001
    assert logs[worse].plain < logs[state.anchors].plain
    predictor.destroy()


@pytest.mark.parametrize(("noise", "sure"), [(0.0003, True), (0.1, False)])
def test_sets_that_data_cannot_tell_apart_are_one_class(slab: Scene, noise: float, sure: bool) -> None:
    simulated = simulate(slab, {"3", "4"}, motion("complex", "II"), noise=noise, random_state=2)
    found = identify(slab, simulated)
    assert found.certified
    assert (found.probability > 0.99) == sure
    assert (len(found.classes[0]) == 1) == sure
    assert found.classes[0][0] == found.anchored
    seen = simulated.positions - found.prediction.positions
    assert np.sqrt(np.mean(seen**2)) == pytest.approx(found.rms, rel=1e-6)
    assert found.discrepancy_probability is not None
    assert found.discrepancy_probability < 0.5


@pytest.mark.parametrize(("count", "shift", "gone"), [(1, 20e-3, 1), (5, 20e-3, 0), (1, 0.5e-3, 0)])
def test_a_fiducial_that_does_not_go_with_the_body_is_astray(slab: Scene, count: int, shift: float, gone: int) -> None:
    """One of sixteen that jumps by 20 mm; not when five do, which is no mistake of single ones, and not for half a millimetre."""
    seen = simulate(slab, {"3", "4"}, motion("complex", "II"), noise=0.0003, random_state=2)
    positions = seen.positions.copy()
    positions[len(positions) // 2 :, :count, 2] += shift * (-1.0) ** np.arange(count)
    data = seen.data.assign(position=(("frame", "fiducial", "axis"), positions))
    predictor, rival = fitted(slab, replace(seen, data=data))
    assert outliers(rival.fitted.state) == tuple(seen.fiducial_names[:gone])
    predictor.destroy()


def every_seventh_solve_fails(patch: pytest.MonkeyPatch) -> None:
    newton, calls = Equilibrium._newton, iter(range(1, 10**9))
    patch.setattr(Equilibrium, "_newton", lambda self: newton(self) if next(calls) % 7 else Status.LINE_SEARCH)


def every_fifth_check_finds_an_unstable_state(patch: pytest.MonkeyPatch) -> None:
    verify, calls = Equilibrium.verify, iter(range(1, 10**9))

    def checked(self: Equilibrium) -> Status:
        return verify(self) if self.careful or next(calls) % 5 else Status.UNSTABLE

    patch.setattr(Equilibrium, "verify", checked)


def every_ninth_factorisation_fails(patch: pytest.MonkeyPatch) -> None:
    factorise, calls = Factor._factorise, iter(range(1, 10**9))
    patch.setattr(Factor, "_factorise", lambda self, package: bool(next(calls) % 9) and factorise(self, package))


@pytest.mark.parametrize(
    "fault", [every_seventh_solve_fails, every_fifth_check_finds_an_unstable_state, every_ninth_factorisation_fails]
)
def test_failures_of_single_solves_change_nothing(
    fault: Fault, slab: Scene, measurement: Any, everything: dict[Anchored, Evidence], monkeypatch: pytest.MonkeyPatch
) -> None:
    fault(monkeypatch)
    same(followed(slab, measurement), everything, measurement.noise_sigma < 0.001)


@pytest.mark.parametrize("weight", [0.0, 3000.0])
@pytest.mark.parametrize("level", [0, 1])
def test_an_old_tangent_leads_to_the_same_states(project: Path, level: int, weight: float) -> None:
    """Quadratic and linear elements, with and without a load: positions to 1e-8 of the motion, with far fewer factorisations."""
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    model = Model.of(scene) + Term("gravity", {"weight": weight}) if weight else None
    forward = Forward(scene, level, model=model, settings=Settings(rtol=1e-10))
    kept = forward.predict({"1", "4"}, motion("semicircle", "II"))
    with pytest.MonkeyPatch.context() as patch:
        plain(patch)
        fresh = forward.predict({"1", "4"}, motion("semicircle", "II"))
    assert not kept.failure
    assert not fresh.failure
    assert np.abs(kept.positions - fresh.positions).max() < 1e-8 * 0.02
    assert kept.trajectories[0].factorisations < fresh.trajectories[0].factorisations / 3
    forward.destroy()


def test_negative_curvature_ends_an_iteration_with_an_old_tangent(slab: Scene) -> None:
    """The pairs of the secant update show it: then Newton's method takes over."""
    forward = Forward(slab, 0)
    equilibrium = forward.equilibrium
    equilibrium.hold({"3"}, "II")
    secant = equilibrium.secant
    secant._last = np.ones(equilibrium._owned), np.zeros(equilibrium._owned)
    secant.observe(-np.ones(equilibrium._owned))
    assert secant.negative
    assert secant._from == secant._to
    equilibrium._first = equilibrium._previous = 1.0
    assert equilibrium._judge(1, 0.5) < 0
    forward.destroy()


@pytest.mark.parametrize(
    ("pull", "anchors", "followed"), [("I+z", "136", True), ("I-z", "126", False), ("III+z", "12", False)]
)
def test_giving_up_bodies_that_are_inside_out_changes_nothing(
    project: Path, monkeypatch: pytest.MonkeyPatch, pull: str, anchors: str, followed: bool
) -> None:
    """Where steps are cut, and where a pull cannot be followed: it ends where it did, and what it shows to there is the same."""
    scene = Scene.read(project / "examples" / "scenes" / "slab_explain.toml", physics=check_physics)
    scene = replace(scene, levels=(Level(2, 0.018),))
    (move,) = (m for m in moves(scene) if m.grasp + m.direction == pull and m.amplitude == 0.008)
    forward = Forward(scene, 0, settings=Settings(rtol=1e-9, halvings=3, max_iterations=20))
    found = forward.predict(anchors, [move.action(limits_of(scene))])
    monkeypatch.setattr(equilibrium, "_INVERTED", 10**9)
    patient = forward.predict(anchors, [move.action(limits_of(scene))])
    assert found.complete == patient.complete == followed
    assert np.allclose(found.positions, patient.positions, rtol=0, atol=1e-9, equal_nan=True)
    one, other = found.trajectories[0], patient.trajectories[0]
    assert (one.steps, one.halvings) == (other.steps, other.halvings)
    assert one.factorisations <= (1.0 if followed else 0.7) * other.factorisations
    assert bool(one.halvings) or not followed
    forward.destroy()


def test_pulls_to_choose_from_are_predicted_well_enough(project: Path) -> None:
    scene = Scene.read(project / "examples" / "scenes" / "slab_explain.toml", physics=check_physics)
    scene = replace(scene, levels=(Level(2, 0.03),))
    pulls = [move.action(limits_of(scene)) for move in moves(scene) if move.grasp == "II"]
    tasks = [(frozenset(anchors), pull) for anchors in ("12", "136") for pull in pulls]

    found = PullPredictor(scene, 0, MPI.COMM_SELF).predict(tasks, detailed=True)
    patient = Settings(rtol=1e-10, halvings=3, max_iterations=20)
    exactly = PullPredictor(scene, 0, MPI.COMM_SELF, settings=patient).predict(tasks, detailed=True)
    for one, exact in zip(found, exactly, strict=True):
        assert one.failed == exact.failed
        assert np.allclose(one.positions, exact.positions, rtol=0, atol=1e-6, equal_nan=True)
        if not exact.failed:
            assert one.force == pytest.approx(exact.force, rel=1e-3)
            assert one.eigenvalue == pytest.approx(exact.eigenvalue, abs=1e-3)


# -- what remembers
# ------------------------------------------------------------------------------------------------------------------

REMEMBERING = {
    "support_friction": {"shear_stress": 60.0},
    "viscosity": {"fraction": 0.4, "relaxation_time": 1.0},
    "permanent_set": {"kept": 0.5, "yield_strain": 0.02},
    "softening": {"softened": 0.6, "strain": 0.1},
}


@pytest.mark.parametrize("name", REMEMBERING)
@pytest.mark.parametrize("unstable", [False, True], ids=["stable", "once unstable"])
def test_a_kept_tangent_leaves_what_remembers_as_it_is(
    slab: Scene, monkeypatch: pytest.MonkeyPatch, name: str, unstable: bool
) -> None:
    """Also where the motion has to be repeated: from rest, for what is remembered cannot be taken back."""
    term = Term(effects.effect(name), REMEMBERING[name])
    scene = replace(slab, levels=(Level(2, 0.03),))
    forward = Forward(scene, 0, model=Model.of(scene) + term, settings=EXACT)
    actions = motion("complex", "II")
    with monkeypatch.context() as patch:
        plain(patch)
        expected = forward.predict({"3", "4"}, actions).positions
    slow = forward.equilibrium.factor.count
    verify, calls = Equilibrium.verify, iter(range(10**9))
    if unstable:
        monkeypatch.setattr(Equilibrium, "verify", lambda self: verify(self) if next(calls) else Status.UNSTABLE)
    found = forward.predict({"3", "4"}, actions).positions
    assert np.abs(found - expected).max() < 1e-8
    if not unstable:
        assert forward.equilibrium.factor.count - slow < 0.7 * slow
    assert next(calls) > 1 or not unstable
    forward.destroy()


def test_sensitivities_in_a_few_steps_tell_those_in_all(project: Path) -> None:
    """Of what a scene may have wrong and of an unknown force, on a way that bends: to a fiftieth, with a third of the steps."""
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    forward, action = Forward(scene, 0), motion("semicircle", "II")[0]
    kept = forward.predict({"1", "2"}, [action], keep=True)
    wanted = Nuisances(scene, forward.mesh).wanted(forward.model, {"1", "2"})
    wanted = replace(wanted, forces=bumps(forward, 4)[1])
    known = knots_of(forward.model, [action], np.ones(len(action), bool))
    assert known is not None
    seen = known_frames(known, len(action))
    assert seen.sum() <= len(action) / 3
    every, few = (Sensitivity(forward).of({"1", "2"}, [action], kept, wanted, None, some) for some in (None, seen))
    for name, array in few.named.items():
        known[0].fill(array)
        assert np.linalg.norm(array - every.named[name]) <= 0.02 * np.linalg.norm(every.named[name]), name
    forward.destroy()


@pytest.mark.parametrize("body", ["slab", "gallbladder"])
def test_states_of_a_coarse_mesh_are_carried_to_a_fine_one(project: Path, body: str) -> None:
    """What is linear in place exactly, outside of facets that cut a round body off as well."""
    scene = Scene.read(project / "examples" / "scenes" / f"{body}.toml", physics=check_physics)
    coarse, fine = (Forward(scene, level, MPI.COMM_SELF, Model.of(scene)) for level in (0, 1))
    slope = np.array([[0.1, 0.2, 0.3], [0.0, 0.1, -0.2], [0.3, 0.0, 0.1]])
    state = np.zeros(coarse.body.unknowns)
    state[coarse.body.displacement_dofs] = (coarse.body.nodes @ slope).ravel()
    found = fine.nearly(coarse, {7: state})[7][fine.body.displacement_dofs]
    assert found == pytest.approx((fine.body.nodes @ slope).ravel(), abs=1e-12)
    coarse.destroy()
    fine.destroy()


def test_the_fine_mesh_is_as_far_away_wherever_it_is_begun(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From states of the working mesh, or from rest; the first with less work."""
    scene = Scene.read(project / "examples" / "scenes" / "slab_explain.toml", physics=check_physics)
    anchors, model = frozenset({"3", "4"}), Model.of(scene)
    measurement = simulate(scene, anchors, motion("pull", "II"), level=0)
    apart, iterations = [], []
    for begun in (True, False):
        if not begun:
            monkeypatch.setattr(Forward, "nearly", lambda *_: {})
        predictor = Predictor(scene, measurement, MPI.COMM_SELF)
        apart.append(mesh_error(predictor, model, anchors, predictor.predict(model, anchors, keep=True)).correction)
        iterations.append(predictor.forward(model, 1).equilibrium.iterations)
        predictor.destroy()
    assert apart[0] == pytest.approx(apart[1], abs=1e-3 * np.abs(apart[1]).max())
    assert iterations[0] < 0.8 * iterations[1]


def test_the_fine_mesh_follows_the_branch_of_the_working_one(project: Path) -> None:
    """A thin slab that is pulled has two stable states; from rest the fine mesh ends in the other one, 50 mm away."""
    scene = Scene.read(project / "examples" / "scenes" / "slab_hidden.toml", physics=check_physics)
    anchors, model, steps = frozenset({"1", "6"}), Model.of(scene), np.arange(5)
    way = steps[:, None] * np.array([2.69e-3, 0.0, 0.0])
    pull = Action("1", steps, steps, "II", way, np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)))
    predictor = Predictor(scene, simulate(scene, anchors, [pull], level=0), MPI.COMM_SELF)
    error = mesh_error(predictor, model, anchors, predictor.predict(model, anchors, keep=True))
    assert np.abs(error.correction).max() < 5e-3
    predictor.destroy()
