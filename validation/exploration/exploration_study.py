"""The exploration study: how many pulls does it take to know how a body is held, and are the answers as certain as they say?

The setting of section 8 of Boonvisut & Cavusoglu (2014): a slab held by {1 2}, {3 4} or {1 2 3 4}, one grasp or three, six
directions, 8 mm and back to rest, no noise and three amounts of it. Pulls chosen by information and by the paper's expected
entropy compete with random ones and with the best single pull, repeated, in the same trials.

Three more parts go beyond the paper: with {3 4}, nothing or one of three effects is hidden, and exploring must tell which;
patches that others enclose make no difference, which must be said instead of guessed; and a gripper feels the force of a body that
is stiffer than its scene.

RUN/predictions/         what every set predicts for every pull, computed first;  precomputed/ one file for each part of that
RUN/results/NAME.json    one trial
RUN/trials.json  table.txt  page.md  picture.png
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from bcid.base.collective import on_root
from bcid.base.errors import InputError, SolveError
from bcid.base.fingerprint import file_fingerprint
from bcid.base.options import ExploreOptions
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import RunFolder, running
from bcid.base.shipped import shipped
from bcid.exploration.choice import Choice, Chooser
from bcid.exploration.explore_run import telling_pull
from bcid.exploration.hypothesis_predictions import HypothesisPredictor
from bcid.exploration.loop import explore, paired, posterior_before
from bcid.exploration.moves import limits_of, moves
from bcid.exploration.posterior_summary import PosteriorSummary
from bcid.exploration.pull_posterior import PullPosterior
from bcid.exploration.robots import Simulated
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import check_physics
from bcid.forms.written_effects import with_effects
from bcid.inference.hypotheses import Hypothesis
from bcid.measurement import Action
from bcid.predict.pull_predictor import PullPredictor
from bcid.predict.store import PredictionStore
from bcid.scene import Level, Scene
from bcid.scene.uncertainty import FORCED, Uncertainty
from bcid.search.hill_climbing import all_candidates
from validation.engine.dispatch import dispatch
from validation.engine.work import Work, Workers, read_result
from validation.exploration.exploration_page import page, shown
from validation.exploration.exploration_scores import scores, table
from validation.exploration.exploration_trials import (
    BUDGET,
    HIDDEN,
    RIVALS,
    STIFFER,
    ExplorationExtent,
    ExplorationTrial,
    trials,
)
from validation.sections import PICTURE
from validation.synthetic.felt import stiffened

SCENE = "examples/scenes/slab_explain.toml"
# Sets that are predicted together.
_SETS = 64
# Of a force sensor, and of the stiffness of a body, as usual (see `Uncertainty`).
_NOT_KNOWN: dict[str, Any] = dict.fromkeys(FORCED)
# Hypotheses whose probabilities are kept after each pull.
_SHOWN = 8
# The truth is computed with other elements than any level of the scene has.
TRUE = Level(degree=3, element_size=0.014)
_MAKES = (
    "predictions/",
    "precomputed/",
    "results/",
    "logs/",
    "trials.json",
    "table.txt",
    "page.md",
    "picture.png",
)


def run_study(
    folder: Path,
    extent: ExplorationExtent,
    seed: int,
    how: Workers,
    progress: Progress | None = None,
    overwrite: bool = False,
    scene_file: Path | None = None,
) -> Path:
    """Run the study into a run folder; collective on `how.comm`. One that was interrupted goes on.

    Raises:
        InputError: the numbers, or a folder that cannot be used (see `RunFolder.start`).
    """
    progress = progress or Silent()
    scene_file = scene_file or shipped(SCENE)
    for name, value, lowest in (("trials", extent.count, 1), ("seed", seed, 0)):
        if value < lowest:
            raise InputError(f"--{name} {value}: must be at least {lowest}")
    inputs = {"extent": json.loads(json.dumps(asdict(extent))), "seed": seed, "scene": file_fingerprint(scene_file)}
    with running(how.comm, folder, "study exploration", inputs, _MAKES, overwrite) as run:
        path = on_root(how.comm, folder.resolve)
        job = {"scene": str(scene_file.resolve()), "predictions": str(path / "predictions"), "seed": seed}
        made = list(trials(extent))
        pulls = on_root(how.comm, lambda: _pulls(_scene(scene_file), made))
        progress.say(f"exploration: {len(pulls)} predictions that all trials share")
        dispatch(
            Work("validation.exploration.exploration_study:precomputer", job, path / "precomputed"),
            pulls,
            how,
            progress,
        )
        progress.say(f"exploration: {len(made)} trials")
        tasks = {trial.name: asdict(trial) for trial in made}
        dispatch(Work("validation.exploration.exploration_study:maker", job, path / "results"), tasks, how, progress)
        on_root(how.comm, lambda: _conclude(run, extent))
    return folder


def _scene(file: Path) -> Scene:
    """The scene with one amplitude, as in the paper; the robots' body is exactly as it is stated."""
    scene = Scene.read(file, physics=check_physics)
    limits = scene.limits and replace(scene.limits, amplitudes=scene.limits.amplitudes[:1])
    return replace(scene, limits=limits, uncertainty=Uncertainty.none())


def _pulls(scene: Scene, made: Sequence[ExplorationTrial]) -> dict[str, dict[str, Any]]:
    """What every set predicts for every pull that a trial may choose, in parts."""
    every = [sorted(anchors) for anchors in all_candidates(list(scene.patches))]
    found: dict[str, dict[str, Any]] = {}
    for name, felt in (("", False), ("felt-", True)):
        grasps = {grasp for trial in made for grasp in trial.grasps if bool(trial.felt) == felt}
        found |= {
            f"{name}{i:03d}-{k:04d}": {"move": i, "sets": every[k : k + _SETS], "felt": felt}
            for i, move in enumerate(moves(scene))
            if move.grasp in grasps
            for k in range(0, len(every), _SETS)
        }
    return found


def precomputer(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that predicts, for `validation.engine.dispatch`; `job` holds the `scene` file and the folder `predictions`."""
    from mpi4py import MPI

    scene = _scene(Path(job["scene"]))
    ladder = paired(scene, None, MPI.COMM_SELF)
    store = PredictionStore(Path(job["predictions"]), MPI.COMM_SELF, shared=True)
    predictors = {
        felt: PullPredictor(ladder, 0, MPI.COMM_SELF, store, gripper=ForceScale.of_body(scene) if felt else None)
        for felt in (False, True)
    }
    limits = limits_of(scene)

    def precompute(task: Mapping[str, Any]) -> dict[str, Any]:
        action, predictor = moves(scene)[task["move"]].action(limits), predictors[task["felt"]]
        # What is built once for all sets does not count as their time.
        predictor.forward()
        began = time.process_time()
        found = predictor.predict([(frozenset(anchors), action) for anchors in task["sets"]], detailed=True)
        seconds = (time.process_time() - began) / len(found)
        return {"failed": sum(predicted.failed for predicted in found), "seconds": round(seconds, 4)}

    return precompute


def maker(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that makes a trial, for `validation.engine.dispatch`; `job` holds also the `seed`."""
    bench = Bench.of(_scene(Path(job["scene"])), Path(job["predictions"]), job["seed"])

    def trial(task: Mapping[str, Any]) -> dict[str, Any]:
        names = {name: tuple(task[name]) for name in ("anchors", "grasps")}
        return attempted(bench, ExplorationTrial(**{**task, **names}))

    return trial


def attempted(bench: Bench, trial: ExplorationTrial) -> dict[str, Any]:
    """The result of a trial; a pull that cannot be followed ends it, and is recorded."""
    try:
        return bench.make(trial)
    except SolveError as error:
        return unmade(trial, str(error))


def unmade(trial: ExplorationTrial, reason: str) -> dict[str, Any]:
    """The result of a trial that came to nothing."""
    nothing = {
        "found": [],
        "effect": "",
        "effects": {},
        "right": False,
        "named": [],
        "told_by": None,
        "probability": 0.0,
        "pulls": 0,
        "moves": [],
        "sets": 0,
        "beliefs": [],
        "asked": [],
        "gained": [],
        "expected": [],
        "stiffness": None,
    }
    return asdict(trial) | {"reason": f"failed: {reason}", "calls": 0, "seconds": 0.0} | nothing


class _Watched(Simulated):
    """A robot that notes, before each pull, how many predictions have been asked for so far.

    Attributes:
        asked: these numbers.
    """

    def __init__(self, watched: Any, *about: Any) -> None:
        super().__init__(*about)
        self.watched = watched
        self.asked: list[int] = []

    def move(self, action: Action) -> None:
        self.asked.append(len(self.watched.asked))
        super().move(action)


def _likeliest(view: PosteriorSummary, scene: Scene) -> dict[str, float]:
    """Probabilities of the likeliest hypotheses, by their labels."""
    shown = list(view.probabilities.items())[:_SHOWN]
    return {hypothesis.label(scene.patches): round(p, 6) for hypothesis, p in shown}


class Bench:
    """Makes trials on one process, with predictions that all trials share."""

    def __init__(self, scene: Scene, predictor: Any, fine: Any, truth: Any, seed: int) -> None:
        self.scene, self.predictor, self.fine, self.truth, self.seed = scene, predictor, fine, truth, seed
        # With what the predictor was asked for it.
        self._first: dict[tuple[str, tuple[str, ...], float], tuple[Choice, set[Any]]] = {}
        self._bodies: dict[str, Any] = {}
        # By the effects that may act.
        self._posteriors: dict[tuple[str, ...], PullPosterior] = {}

    @classmethod
    def of(cls, scene: Scene, store: Path, seed: int) -> Bench:
        """With predictors of a scene on this process alone."""
        from mpi4py import MPI

        ladder, true = paired(scene, None, MPI.COMM_SELF), replace(scene, levels=(TRUE,))
        known = PredictionStore(store, MPI.COMM_SELF, shared=True)
        working, *fine = (PullPredictor(ladder, level, MPI.COMM_SELF, known) for level in range(len(ladder.levels)))
        truth = PullPredictor(true, 0, MPI.COMM_SELF, known)
        return cls(scene, working, fine[0] if fine else None, truth, seed)

    def make(self, trial: ExplorationTrial) -> dict[str, Any]:
        """One trial."""
        if trial.felt:
            return self.feeling.make_here(trial)
        return self.make_here(trial)

    def make_here(self, trial: ExplorationTrial) -> dict[str, Any]:
        """One trial with the predictors of this bench."""
        start = time.perf_counter()
        self.predictor.asked = set()
        plan = ExploreOptions(
            criterion=trial.strategy if trial.strategy != "fixed" else "information",
            grasps=trial.grasps,
            noise=trial.noise,
            budget=BUDGET,
            # Only what is drawn for random pulls differs from trial to trial.
            seed=trial.number if trial.strategy == "random" else 0,
            consider=RIVALS if trial.hidden else (),
            wrench_noise=trial.felt or None,
        )
        scene = self.scene
        if trial.strategy == "fixed":
            best = self.first(replace(plan, criterion="information"), trial).move
            assert best is not None
            assert scene.limits is not None
            directions = {best.direction: scene.limits.directions[best.direction]}
            scene = replace(scene, limits=replace(scene.limits, directions=directions))
            plan = replace(plan, grasps=(best.grasp,), look_ahead=False)
        state = self.seed + 1000 * trial.number
        robot = _Watched(self.predictor, self.body(trial.hidden), trial.anchors, trial.noise, state, trial.felt)
        first = self.first(plan, trial) if trial.strategy in ("information", "entropy") else None
        found = explore(scene, robot, plan, self.predictor, self.fine, first=first, posterior=self.posterior(plan))
        told = telling_pull(plan, found)
        return asdict(trial) | {
            "reason": found.reason,
            "found": sorted(found.view.best.anchors),
            "effect": found.view.best.effect,
            "effects": found.view.effects,
            "right": found.view.best == Hypothesis(frozenset(trial.anchors), trial.effect),
            "named": [sorted(h.anchors) for h in found.rivals],
            "told_by": told.number if told else None,
            "probability": found.view.certainty,
            "pulls": len(found.steps),
            "moves": [str(step.move) for step in found.steps],
            "sets": len(found.view.probabilities),
            "beliefs": [_likeliest(step.view, scene) for step in found.steps],
            "asked": robot.asked,
            "gained": [step.gained for step in found.steps],
            "expected": [None if math.isnan(step.expected[0]) else step.expected[0] for step in found.steps],
            "stiffness": found.view.stiffness.record().to_json() if found.view.stiffness else None,
            "calls": len(self.predictor.asked),
            "seconds": round(time.perf_counter() - start, 3),
        }

    @cached_property
    def feeling(self) -> Bench:
        """The same with a gripper that feels forces; the body is stiffer than its scene, which does not know that well."""
        gripper = ForceScale.of_body(self.scene)
        scene = replace(self.scene, uncertainty=replace(self.scene.uncertainty, **_NOT_KNOWN))

        def alike(predictor: Any, of: Scene) -> Any:
            about = predictor.level, predictor.comm, predictor.store
            return PullPredictor(replace(of, levels=predictor.scene.levels), *about, gripper=gripper)

        stiffer = stiffened(scene, STIFFER)
        fine = None if self.fine is None else alike(self.fine, scene)
        return Bench(scene, alike(self.predictor, scene), fine, alike(self.truth, stiffer), self.seed)

    def posterior(self, plan: ExploreOptions) -> PullPosterior:
        """Before any pull; trials share its meshes and what it predicts."""
        if plan.consider not in self._posteriors:
            known, comm = self.predictor.store, self.predictor.comm
            store = PredictionStore(known.folder, comm, shared=True) if known else None
            self._posteriors[plan.consider] = posterior_before(self.scene, plan, self.predictor, store)
        return self._posteriors[plan.consider].anew()

    def body(self, hidden: str) -> Any:
        """PullPredictor of what the body is really made of."""
        if not HIDDEN.get(hidden):
            return self.truth
        if hidden not in self._bodies:
            scene = with_effects(self.truth.scene, HIDDEN[hidden])
            self._bodies[hidden] = PullPredictor(scene, self.truth.level, self.truth.comm, self.truth.store)
        return self._bodies[hidden]

    def first(self, plan: ExploreOptions, trial: ExplorationTrial) -> Choice:
        """The first choice of a strategy, which is the same in every trial."""
        key = plan.criterion, trial.grasps, trial.noise
        asked = self.predictor.asked
        if key not in self._first:
            self.predictor.asked = set()
            options = tuple(m for m in moves(self.scene) if plan.grasps is None or m.grasp in plan.grasps)
            about = plan.criterion, plan.look_ahead, plan.samples, trial.noise, 0, trial.felt
            chooser = Chooser(self.scene, HypothesisPredictor(self.predictor, self.fine), options, *about)
            self._first[key] = (
                chooser.choose(self.posterior(plan).before(self.fine is not None), None),
                self.predictor.asked,
            )
        choice, more = self._first[key]
        self.predictor.asked = asked | more
        return choice

    def destroy(self) -> None:
        """Free the PETSc objects."""
        joined = [posterior.predictors for posterior in self._posteriors.values()]
        for predictor in (self.predictor, self.fine, self.truth, *self._bodies.values(), *joined):
            if predictor is not None:
                predictor.destroy()
        if "feeling" in self.__dict__:
            self.feeling.destroy()


def _result(path: Path, trial: ExplorationTrial) -> dict[str, Any]:
    """What became of a trial; one that was not made for another reason than a pull that cannot be followed ended as well."""
    content = read_result(path / "results" / f"{trial.name}.json")
    result: dict[str, Any] = content["result"] or unmade(trial, content["reason"])
    return result


def results(path: Path, extent: ExplorationExtent) -> list[dict[str, Any]]:
    """What became of every trial of a run."""
    return [_result(path, trial) for trial in trials(extent)]


def call_cost(path: Path) -> float:
    """CPU seconds of one prediction of a pull with a set, the mean of what was computed first; NaN where nothing was."""
    made = [read_result(file)["result"] for file in sorted((path / "precomputed").glob("*.json"))]
    told = [result["seconds"] for result in made if result]
    return sum(told) / len(told) if told else math.nan


def _conclude(run: RunFolder | None, extent: ExplorationExtent) -> None:
    assert run is not None
    made = results(run.path, extent)
    found = scores(made)
    run.write_json("trials.json", found)
    run.write_text("table.txt", table(found))
    run.write_text("page.md", page(made, call_cost(run.path), _draw(run, made)))
    run.finish({"calibration": found["calibration"]})


def _draw(run: RunFolder, made: Sequence[Mapping[str, Any]]) -> bool:
    """Whether there is a picture: without matplotlib there is none."""
    try:
        from validation.plots import progression
    except ImportError:
        return False
    progression(run.path / PICTURE, [trial for trial in made if shown(trial)])
    return True
