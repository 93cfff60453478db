"""C6 on any number of ranks: the numbers of one rank, and failures on all ranks or none.

Run as ``mpirun -n N python -m pytest tests/parallel`` with N = 1, 2, 3.
Every rank computes the answer for itself on COMM_SELF, and then with the others on a mesh that is shared out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray
from verify.problems import box, move, pull_and_lift, scene_of, straight

from bcid.base.collective import Comm, on_root
from bcid.base.errors import BcidError, InputError
from bcid.base.options import ExploreOptions, IdentifyOptions
from bcid.base.scheduler import counter, share
from bcid.exploration.loop import Exploration, explore
from bcid.exploration.robots import Simulated
from bcid.forms.forward import Forward, Prediction
from bcid.forms.mesh import level_mesh
from bcid.forms.mesh.body import Body
from bcid.forms.mesh.patches import halves
from bcid.forms.model import Anchors, Held, Model, Term, check_physics
from bcid.forms.probes import Probe, SensitivityRequest
from bcid.forms.simulate import simulate
from bcid.forms.solver.equilibrium import Equilibrium, Settings
from bcid.forms.solver.factor import Factor
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import nodal_weights
from bcid.forms.solver.trajectory import follow
from bcid.predict.predictor import Predictor
from bcid.predict.pull_predictor import PullPredictor
from bcid.predict.store import PredictionStore
from bcid.scene import Level, Limits, Region, Scene
from bcid.scene.motions import about_x, motion
from bcid.search.answer.refine import identify_refined
from bcid.search.answer.source import from_files
from bcid.search.fitting.curvature import curvature
from bcid.search.fitting.state import State
from bcid.search.identify import identify
from bcid.search.set_misfits import MeasuredMisfits

pytestmark = pytest.mark.parallel

T = TypeVar("T")
Array = NDArray[np.float64]
WORLD = MPI.COMM_WORLD
SAME = 1e-10
EXACT = Settings(rtol=1e-12)


def same_everywhere(value: Any) -> bool:
    """Whether every rank has the same value, to the last bit."""
    values = WORLD.allgather(value)
    return all(np.array_equal(v, values[0]) if isinstance(v, np.ndarray) else v == values[0] for v in values)


def close(a: Array, b: Array) -> None:
    """Fail on all ranks when two arrays differ on any: one that failed alone would leave the others waiting."""
    ok = bool(np.abs(a - b).max() <= SAME * np.abs(b).max())
    assert all(WORLD.allgather(ok))


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    return Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)


def test_a_shared_mesh_gives_the_same_field(slab40: Callable[..., Any]) -> None:
    fields, scales = [], []
    for comm in (MPI.COMM_SELF, WORLD):
        benchmark = slab40("small", comm, rtol=1e-12)
        result = follow(benchmark.equilibrium, pull_and_lift(10), lambda _k, _pose: None)
        assert (result.status, result.steps) == (Status.CONVERGED, 21)
        fields.append(benchmark.displacement())
        scales.append(benchmark.equilibrium._scale())
        benchmark.equilibrium.destroy()
    close(fields[1], fields[0])
    # All ranks must judge convergence by the same forces, or some go on while others have stopped.
    assert scales[1] == pytest.approx(scales[0], rel=1e-9)
    assert same_everywhere(scales[1])
    assert np.abs(fields[1] - benchmark.field).max() <= 1e-9 * np.abs(benchmark.field).max()


def alone_and_together(made: Callable[[Comm], T]) -> tuple[T, T]:
    """What is made on each rank for itself, and by all together; a single rank makes it once."""
    alone = made(MPI.COMM_SELF)
    return alone, made(WORLD) if WORLD.size > 1 else alone


def twisted() -> list[Any]:
    """Two actions: a pull with a twist, and one with another grasp."""
    part = np.arange(5) / 4
    first = move(part[:, None] * [0.006, 0.004, 0.0], "II", rotations=about_x(15.0 * part))
    second = move(part[:, None] * [0.0, 0.003, 0.006], "I")
    return [first, replace(second, name="2", frames=second.frames + len(first))]


def predictions(scene: Scene, model: Model, level: int) -> tuple[Prediction, Prediction]:
    """On one rank and on all."""

    def predicted(comm: Comm) -> Prediction:
        forward = Forward(scene, level, comm, model, EXACT)
        made = forward.predict({"1", "4"}, twisted(), keep=True)
        found = forward.detail({"1", "4"}, twisted(), made)
        forward.destroy()
        return found

    return alone_and_together(predicted)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    "term",
    [None, Term("gravity", {"weight": 2000.0}), Term("grasp_compliance", {"stiffness": 5e5})],
    ids=lambda term: term.label if term else "plain",
)
def test_fiducials_and_wrench_do_not_depend_on_the_ranks(slab: Scene, degree: int, term: Term | None) -> None:
    scene = replace(slab, levels=(Level(degree, 0.020),))
    model = Model.of(scene)
    if term:
        model = model + term
    alone, together = predictions(scene, model, 0)
    assert alone.failure is None
    assert together.failure is None
    close(together.positions, alone.positions)
    close(together.wrench, alone.wrench)
    assert same_everywhere(together.positions)
    assert same_everywhere(together.wrench)


def test_a_twin_predicts_and_differentiates_alike_on_any_number_of_ranks(slab: Scene) -> None:
    """Actions are spread over the ranks; every rank has all of the answer."""
    scene = replace(slab, levels=(Level(2, 0.050), Level(2, 0.025)), noise_sigma=1e-6)
    measurement = simulate(scene, {"1", "4"}, twisted(), level=0)
    gravity = Term("gravity", {"weight": 500.0})
    model, wanted = (
        Model.of(scene) + gravity,
        SensitivityRequest((Probe(gravity, ("weight",)),), {"young": 1.5}, stiffness=True),
    )
    answers = []
    for comm in (MPI.COMM_SELF, WORLD):
        predictor = Predictor(scene, measurement, comm, 1, EXACT)
        state = State.of(predictor, model, frozenset({"1", "4"}))
        found = predictor.sensitivities(model, state.anchors, state.prediction, wanted)
        assert found.stiffness is not None
        # Begun at the states of the rank that has them.
        missed = curvature(state)
        assert missed.any()
        answers.append((state.scaled, found.probes[0]["weight"], found.law["young"], found.stiffness, missed))
        predictor.destroy()
    for alone, together in zip(*answers, strict=True):
        close(together, alone)
        assert same_everywhere(together)


def test_what_some_ranks_have_kept_is_known_to_others(slab: Scene, tmp_path: Path) -> None:
    """Every rank has its own actions' states again, and one rank alone has all."""
    scene = replace(slab, levels=(Level(2, 0.050),))
    measurement = simulate(scene, {"1", "4"}, twisted(), level=0)
    model, wanted, anchors = Model.of(scene), SensitivityRequest(law=("young",)), frozenset({"1", "4"})
    folder = WORLD.bcast(tmp_path)
    found = []
    for comm in (WORLD, WORLD, MPI.COMM_SELF) if WORLD.rank == 0 else (WORLD, WORLD):
        store = PredictionStore(folder, comm)
        predictor = Predictor(scene, measurement, comm, settings=EXACT, store=store)
        prediction = predictor.predict(model, anchors, keep=True)
        states = {frame: state for part in prediction.parts.values() for frame, state in (part.states or {}).items()}
        young = predictor.sensitivities(model, anchors, prediction, wanted).law["young"]
        tangent = predictor.set_tangent(model, anchors, prediction).moved({"1"})
        found.append((prediction.positions, states, young, tangent, store.recalled, dict(predictor.trajectories)))
        predictor.destroy()
    (positions, states, *rest, none, counted), *others = found
    assert none == 0
    for again, known, *same, recalled, told in others:
        assert recalled == 3
        assert told == counted
        assert states.keys() <= known.keys()
        assert all(np.array_equal(known[frame], state) for frame, state in states.items())
        assert np.array_equal(again, positions)
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(same, rest, strict=True))
    if WORLD.rank == 0:
        assert len(found[-1][1]) == len(measurement.positions)


def test_multigrid_on_a_shared_mesh_gives_the_same_field() -> None:
    """With a mesh of more unknowns than the coarsest level may have."""
    scene = scene_of(("x0",), "x1")
    model = Model.of(scene) + Anchors({"x0"}) + Held("x1")

    def solved(comm: Comm) -> Array:
        body = Body(comm, box((0.1, 0.065, 0.006), (36, 24, 3)))
        solver = Equilibrium(body, model, scene, Settings(1e-11, linear="gamg"))
        result = follow(solver, straight((0.004, 0.0, 0.002), 2, "x1"), lambda _k, _pose: None)
        assert result.status is Status.CONVERGED
        found = body.at_mesh_nodes(solver.displacement())
        solver.destroy()
        return found

    close(*alone_and_together(solved))


def test_a_dead_load_is_shared_out_once(project: Path) -> None:
    scene = Scene.read(project / "examples" / "scenes" / "beam.toml", physics=check_physics)
    mesh = level_mesh(scene, scene.levels[1], WORLD)
    for region in (Region(("top",)), Region(("tip_edge",))):
        shares = nodal_weights(Body(WORLD, mesh, 2), region, "place")
        assert WORLD.allreduce(shares.sum()) == pytest.approx(1.0, abs=1e-12)


def test_the_mixed_formulation_does_not_depend_on_the_ranks(project: Path) -> None:
    scene = Scene.read(project / "examples" / "scenes" / "beam.toml", physics=check_physics)
    fields = []
    for comm in (MPI.COMM_SELF, WORLD):
        forward = Forward(scene, 0, comm, settings=EXACT)
        load = {"tip_edge": np.array([[0.0, 0.0, -0.5]])}
        prediction = forward.predict({"clamp"}, [move(np.zeros((1, 3)), grasp="", loads=load)])
        assert prediction.failure is None
        fields.append(prediction.positions)
        forward.destroy()
    close(fields[1] - scene.rest, fields[0] - scene.rest)


def test_an_unstable_state_is_seen_on_every_number_of_ranks(slab40: Callable[..., Any]) -> None:
    benchmark = slab40("medium", WORLD)
    path = np.linspace(0, 1, 11)[:, None] * [-0.020, 0.0, 0.0]
    result = follow(benchmark.equilibrium, move(path), lambda _k, _pose: None)
    assert same_everywhere(str(result.status))
    if result.status is not Status.UNSTABLE:
        assert result.status is Status.CONVERGED
        assert benchmark.displacement()[benchmark.probe, 2] * 1e3 == pytest.approx(-15.959, abs=5e-4)
    benchmark.equilibrium.destroy()


@pytest.fixture(scope="module")
def measured(slab: Scene) -> Any:
    """A short simulated measurement on the coarsest level, patches 3 and 4 anchored."""
    actions = motion("pull", "II")
    return simulate(slab, {"3", "4"}, actions, level=0, noise=0.0003, random_state=1, comm=WORLD)


def test_a_simulated_measurement_is_the_same_everywhere(slab: Scene, measured: Any) -> None:
    alone = simulate(slab, {"3", "4"}, motion("pull", "II"), level=0, noise=0.0003, random_state=1)
    close(measured.positions, alone.positions)
    assert same_everywhere(measured.positions)


@pytest.mark.parametrize("exhaustive", ["no", "yes"])
def test_candidates_spread_over_ranks_give_the_same_ranking(slab: Scene, measured: Any, exhaustive: str) -> None:
    options = IdentifyOptions(exhaustive=exhaustive, level=0)
    slab = replace(slab, patches={name: slab.patches[name] for name in "1347"})
    # Each rank reads the measurement as rank 0 has it: the input of one search is the same on all ranks.
    measurement = WORLD.bcast(measured, root=0)
    alone = identify(slab, measurement, MPI.COMM_SELF, options)
    together = identify(slab, measurement, WORLD, options)
    assert together.anchored == alone.anchored == ("3", "4")
    assert [a.anchored for a in together.alternatives] == [a.anchored for a in alone.alternatives]
    assert together.probability == pytest.approx(alone.probability, rel=1e-6)
    assert together.rms == pytest.approx(alone.rms, rel=1e-9)
    assert same_everywhere(together.anchored)
    assert same_everywhere(together.rms)
    assert together.evaluations == pytest.approx(alone.evaluations)


def test_refined_patches_are_the_same_on_every_number_of_ranks(slab: Scene) -> None:
    """Patch 7 is anchored where x < 25 mm; two patches and a short pull keep it quick."""
    scene = replace(slab, patches={name: slab.patches[name] for name in "37"})
    path = motion("pull", "II")[0]
    pull = [
        replace(
            path,
            frames=path.frames[:4],
            steps=path.steps[:4],
            translation=2 * path.translation[:4],
            rotation=path.rotation[:4],
        )
    ]
    truth = replace(halves(scene, "7", WORLD), levels=(Level(2, 0.020),))
    made = simulate(truth, {"7.1"}, pull, level=0, noise=0.0003, random_state=1, comm=WORLD)
    measurement = WORLD.bcast(made, root=0)
    options = IdentifyOptions(level=1)
    alone, together = alone_and_together(lambda comm: identify_refined(scene, measurement, comm, options, 1))
    assert together.found.anchored == alone.found.anchored == ("7.1",)
    assert together.refined == alone.refined == {"7": ("7.1", "7.2")}
    assert together.log == alone.log
    assert together.scene.patches == alone.scene.patches
    assert together.found.probability == pytest.approx(alone.found.probability, rel=1e-6)
    assert together.evaluations == pytest.approx(alone.evaluations)
    assert same_everywhere(together.found.rms)
    assert same_everywhere(together.log)


def test_teams_share_a_mesh_and_the_sets(slab: Scene, measured: Any) -> None:
    """A mesh above the limit goes to teams: all ranks together here, so that each sees every set."""
    measurement = WORLD.bcast(measured, root=0)
    found, changes = [], []
    for comm, per_rank in ((MPI.COMM_SELF, 10**9), (WORLD, 1)):
        model = MeasuredMisfits(slab, measurement, comm, settings=EXACT, per_rank=per_rank)
        assert model.forward(0).comm.size == (1 if comm is MPI.COMM_SELF else WORLD.size)
        misfits = model.misfits(0, dict.fromkeys([frozenset("34"), frozenset("1"), frozenset()], math.inf))
        found.append(
            [(m, one.share, one.failure) for m, one in zip(misfits.values(), model.known.values(), strict=True)]
        )
        changes.append(model.positions(0, frozenset("34")))
        model.destroy()
    alone, together = found
    assert [o[1:] for o in together] == [o[1:] for o in alone]
    assert [o[0] for o in together] == pytest.approx([o[0] for o in alone], rel=1e-6)
    assert np.allclose(*changes, atol=1e-9)
    assert same_everywhere(together)


def test_every_task_is_taken_once() -> None:
    for _ in range(3):
        tickets = counter(WORLD)
        mine = list(share(range(200), tickets))
        tickets.close()
        taken = [task for tasks in WORLD.allgather(mine) for task in tasks]
        assert sorted(taken) == list(range(200))


def test_errors_are_raised_on_every_rank(slab: Scene, tmp_path_factory: pytest.TempPathFactory) -> None:
    def fail() -> None:
        raise InputError("only rank 0 looked")

    with pytest.raises(InputError, match="only rank 0 looked"):
        on_root(WORLD, fail)
    broken = tmp_path_factory.mktemp(f"rank{WORLD.rank}") / "broken.geo"
    broken.write_text('Box(1) = {0, 0};\nPhysical Volume("body") = {1};\n')
    with pytest.raises(BcidError):
        Forward(replace(slab, geometry=broken), 0, WORLD)
    forward = Forward(slab, 0, WORLD)
    with pytest.raises(InputError, match="patch '9'"):
        forward.predict({"9"}, twisted())
    with pytest.raises(InputError, match="place 'nowhere'"):
        forward.predict({"3"}, [move(np.zeros((2, 3)), "II", loads={"nowhere": np.ones((2, 3))})])
    forward.destroy()
    with pytest.raises(InputError, match="patch far"):
        Forward(replace(slab, patches={"far": Region(("nothing",))}), 0, WORLD).predict({"far"}, twisted())
    WORLD.barrier()


def test_an_effect_file_that_fails_on_one_rank_is_told_on_every_rank(
    project: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = WORLD.bcast(tmp_path_factory.mktemp("effect") if WORLD.rank == 0 else None)
    path = folder / "mine.py"
    examples = project / "examples"
    text = (examples / "effects" / "magnetic_force.py").read_text(encoding="utf-8")
    text += "\nfrom mpi4py import MPI\nassert MPI.COMM_WORLD.rank != MPI.COMM_WORLD.size - 1, 'the last rank'\n"
    on_root(WORLD, lambda: path.write_text(text, encoding="utf-8"))
    seen = examples / "measurements" / "slab-12-semicircle"
    with pytest.raises(InputError, match="AssertionError: the last rank"):
        from_files(examples / "scenes" / "slab.toml", seen, (path,), WORLD)


def test_a_failed_solve_is_told_on_every_rank(slab: Scene) -> None:
    forward = Forward(slab, 0, WORLD, settings=Settings(halvings=0, max_iterations=3))
    prediction = forward.predict({"3", "4"}, [move([[0, 0, 0], [0.0, 0.3, 0.0]], "II")])
    assert prediction.failure is not None
    assert same_everywhere(str(prediction.failure.status))
    assert same_everywhere(prediction.failure.steps)
    assert not prediction.complete
    forward.destroy()


def test_a_failed_factorisation_has_a_name_and_leaves_no_trace(slab: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    forward = Forward(slab, 0, WORLD, settings=EXACT)
    before = forward.predict({"1", "4"}, twisted())
    working, calls = Factor._factorise, []

    def failing(factor: Factor, package: str) -> bool:
        calls.append(package)
        return len(calls) < 4 and working(factor, package)

    monkeypatch.setattr(Factor, "_factorise", failing)
    failure = forward.predict({"1", "4"}, twisted()).failure
    monkeypatch.undo()
    assert failure is not None
    assert failure.status is Status.LINEAR_SOLVER
    close(forward.predict({"1", "4"}, twisted()).positions, before.positions)
    forward.destroy()


def test_the_grasp_may_be_held_without_anchors(slab: Scene) -> None:
    forward = Forward(slab, 0, WORLD, Model.of(slab) + Held("II"), EXACT)
    prediction = forward.predict((), [move([[0, 0, 0], [0.01, 0.02, 0.03]], "II")])
    assert prediction.failure is None
    assert prediction.positions[-1] - forward.observer.rest == pytest.approx(
        np.tile([0.01, 0.02, 0.03], (len(slab.fiducials), 1)), abs=1e-12
    )
    forward.destroy()


def test_an_exploration_does_not_depend_on_the_number_of_ranks(slab: Scene) -> None:
    directions = {"+x": (1.0, 0.0, 0.0), "+y": (0.0, 1.0, 0.0)}
    limits = Limits(0.008, amplitudes=(0.008,), directions=directions)
    scene = replace(slab, patches={name: slab.patches[name] for name in "124"}, limits=limits)

    def explored(comm: Comm) -> Exploration:
        predictor, body = PullPredictor(scene, 0, comm), PullPredictor(scene, 0, MPI.COMM_SELF)
        plan = ExploreOptions(noise=3e-3, budget=2, samples=100, grasps=("II",))
        found = explore(scene, Simulated(body, "12", 3e-3, 1), plan, predictor)
        predictor.destroy()
        body.destroy()
        return found

    one, all_ranks = alone_and_together(explored)
    assert all(WORLD.allgather([s.move for s in one.steps] == [s.move for s in all_ranks.steps]))
    close(np.array(list(all_ranks.view.patches.values())), np.array(list(one.view.patches.values())))
    assert same_everywhere([s.expected for s in all_ranks.steps])


def test_rival_effects_do_not_depend_on_the_ranks(coarser_scene: Path) -> None:
    """A weight that the scene does not know of: the same hypotheses and numbers on all ranks as on one."""
    whole = Scene.read(coarser_scene)
    scene = replace(whole, patches={name: whole.patches[name] for name in "34"})
    heavy = replace(scene, effects={"gravity": {"weight": "1500 N/m^3"}})

    def explored(comm: Comm) -> Exploration:
        predictor, body = PullPredictor(scene, 0, comm), PullPredictor(heavy, 0, MPI.COMM_SELF)
        plan = ExploreOptions(noise=3e-3, budget=1, samples=100, grasps=("II",), consider=("gravity",))
        found = explore(scene, Simulated(body, "34", 3e-3, 1), plan, predictor)
        predictor.destroy()
        body.destroy()
        return found

    one, all_ranks = alone_and_together(explored)
    assert same_everywhere([s.view.probabilities for s in all_ranks.steps])
    apart = [
        abs(a - b)
        for mine, every in zip(one.steps, all_ranks.steps, strict=True)
        for a, b in zip(mine.view.effects.values(), every.view.effects.values(), strict=True)
    ]
    assert all(WORLD.allgather([s.move for s in one.steps] == [s.move for s in all_ranks.steps]))
    # Which rank fits with which tangent at hand shows far behind what noise leaves open.
    assert all(WORLD.allgather(max(apart) < 1e-4 and bool(one.view.fitted)))
