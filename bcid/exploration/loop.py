"""The exploration: choose a pull, make it, look, believe, until the anchors are decided or nothing that is allowed tells more."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError, SolveError, nearest
from bcid.base.options import ExploreOptions
from bcid.base.progress import Progress, Silent
from bcid.base.units import percent
from bcid.exploration.choice import Choice, Chooser, Option
from bcid.exploration.hypothesis_predictions import HypothesisPredictor
from bcid.exploration.joined import JoinedPredictors
from bcid.exploration.moves import Move, cost, limits_of, moves
from bcid.exploration.posterior_summary import PosteriorSummary
from bcid.exploration.pull_posterior import PullPosterior
from bcid.exploration.robots import Robot
from bcid.forms import effects
from bcid.forms.gripper_force import ForceScale
from bcid.inference.hypotheses import Hypothesis
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Measurement
from bcid.predict.levels import affordable, pair
from bcid.predict.pull_predictor import PullPredictor
from bcid.predict.store import PredictionStore
from bcid.scene import Scene

_UNCOUNTED = "holds forces of the gripper, which do not count: state their noise with --wrench-noise"
DECIDED, INSEPARABLE, BUDGET, UNEXPLAINED = "decided", "inseparable", "budget", "unexplained"


def check(options: ExploreOptions, scene: Scene) -> None:
    """Refuse what makes no sense.

    Raises:
        InputError: which value, and what is allowed.
    """
    limits_of(scene)
    options.check(scene)
    for name in options.consider:
        if name not in effects.names():
            raise InputError(f"--consider {name}: {nearest(name, effects.names())}")
        if name in scene.effects:
            raise InputError(f"--consider {name}: the scene's model has it already")
    for name in options.grasps or ():
        if name not in scene.grasps:
            raise InputError(f"--grasps {name}: is not in the scene; {nearest(name, scene.grasps)}")


def gripper_scale(options: ExploreOptions, scene: Scene) -> ForceScale | None:
    """What forces of the gripper are divided by, where they count; for predictors."""
    return None if options.wrench_noise is None else ForceScale.of_body(scene)


@dataclass(frozen=True)
class Step:
    """One pull of an exploration.

    Attributes:
        number: from 1.
        move: the pull.
        expected: information that was expected, bits, and its standard error; NaN where it was not asked for.
        gained: by how much the entropy fell, bits.
        view: what is believed after it.
        options: what else was considered.
        ahead: the second pull that was thought of, if that decided the choice.
        spent: cost of all pulls so far.
        predicted: actions predicted for this step, on all levels.
        seconds: of computing.
    """

    number: int
    move: Move
    expected: tuple[float, float]
    gained: float
    view: PosteriorSummary
    options: tuple[Option, ...]
    ahead: Move | None
    spent: float
    predicted: int
    seconds: float


@dataclass(frozen=True)
class Exploration:
    """What an exploration found.

    Attributes:
        reason: why it ended: "decided", "inseparable", "budget", or "unexplained": a set is the likeliest by far, but does not
            explain what was seen.
        view: what is believed at the end.
        steps: the pulls.
        rivals: for "inseparable", the hypotheses that no allowed pull separates.
        options: for "inseparable", the pulls that were considered in vain.
        remarks: what is odd about what was seen.
    """

    reason: str
    view: PosteriorSummary
    steps: tuple[Step, ...]
    rivals: tuple[Hypothesis, ...] = ()
    options: tuple[Option, ...] = ()
    remarks: tuple[str, ...] = ()


def paired(scene: Scene, level: int | None, comm: Comm) -> Scene:
    """The scene with two levels: the working one, and the one that tells its error, where there is one; collective.

    As in a `Predictor`, for a level of the scene, by default the last with at most 40,000 unknowns.
    """
    return replace(scene, levels=pair(scene, affordable(scene, comm) if level is None else level, comm))


def explore(
    scene: Scene,
    robot: Robot | None,
    options: ExploreOptions,
    predictor: PullPredictor,
    fine: PullPredictor | None = None,
    progress: Progress | None = None,
    made: Iterable[tuple[Move, Measurement]] = (),
    keep: Callable[[Move, Measurement], None] | None = None,
    first: Choice | None = None,
    posterior: PullPosterior | None = None,
) -> Exploration:
    """Explore until the anchors are decided, or cannot be; collective on the ranks of the predictor.

    Args:
        scene: the scene, with limits.
        robot: makes the pulls; needed on rank 0 only.
        options: how to go on.
        predictor: of the level on which sets are compared.
        fine: of a finer level, on which a pull must be possible too.
        progress: told what goes on (give it on rank 0 only).
        made: pulls that were made before, by an exploration that was interrupted.
        keep: called on rank 0 with each pull that was made.
        first: the first choice, where it is known: it depends on nothing that is seen.
        posterior: before any pull, whose meshes are shared with other explorations; by default one of its own.

    Raises:
        InputError: options or measurement do not fit the scene.
        BcidError: whatever the robot raises.
    """
    check(options, scene)
    own = posterior or posterior_before(scene, options, predictor)
    loop = _Loop(scene, robot, options, predictor, fine, progress or Silent(), list(made), keep, first, own)
    try:
        return replace(loop.run(), remarks=tuple(loop.remarks))
    finally:
        if posterior is None:
            own.predictors.destroy()


def posterior_before(
    scene: Scene, options: ExploreOptions, working: PullPredictor, store: PredictionStore | None = None
) -> PullPosterior:
    """The posterior of an exploration before any pull, with a store of predictions."""
    known = effects.catalogue(options.consider) if options.consider else []
    predictors = JoinedPredictors(scene, working.comm, options.level, store)
    return PullPosterior(scene, working, predictors, known, options.seed)


class _Loop:
    def __init__(
        self,
        scene: Scene,
        robot: Robot | None,
        options: ExploreOptions,
        predictor: PullPredictor,
        fine: PullPredictor | None,
        progress: Progress,
        made: list[tuple[Move, Measurement]],
        keep: Callable[[Move, Measurement], None] | None,
        first: Choice | None,
        posterior: PullPosterior,
    ) -> None:
        self.first, self.posterior = first, posterior
        posterior.progress = progress
        self.remarks: list[str] = []
        self.scene, self.robot, self.options, self.progress = scene, robot, options, progress
        self.predictors = [p for p in (predictor, fine) if p is not None]
        self.comm, self.made, self.keep = predictor.comm, made, keep
        noise = options.noise if options.noise is not None else scene.noise_sigma or 0.0
        self.chooser = Chooser(
            scene,
            HypothesisPredictor(predictor, fine),
            tuple(m for m in moves(scene) if options.grasps is None or m.grasp in options.grasps),
            options.criterion,
            options.look_ahead,
            options.samples,
            noise,
            options.seed,
            options.wrench_noise or 0.0,
        )
        self.steps: list[Step] = []
        self.spent = 0.0

    def run(self) -> Exploration:
        view = self.posterior.before(len(self.predictors) > 1)
        limits = limits_of(self.scene)
        while True:
            if self.steps and view.certainty >= self.options.confidence:
                return Exploration(
                    DECIDED if view.missing < THRESHOLDS.credible else UNEXPLAINED, view, tuple(self.steps)
                )
            began, count = time.perf_counter(), self._predicted()
            last = self.steps[-1].move if self.steps else None
            choice = self._choose(view, last)
            if choice.move is None:
                return Exploration(INSEPARABLE, view, tuple(self.steps), self._rivals(view), choice.options)
            price = cost(choice.move, last, limits)
            if self.spent + price > self.options.budget * (1 + 1e-9):
                return Exploration(BUDGET, view, tuple(self.steps))
            number = len(self.steps) + 1
            self._announce(number, choice)
            waiting = time.perf_counter()
            try:
                measurement = self._pull(number, choice.move)
            except SolveError as error:
                self._give_up(choice.move, str(error))
                continue
            waiting = time.perf_counter() - waiting
            self._examine(number, measurement)
            before, view = view, self._after(number, measurement, view)
            self.spent += price
            self.steps.append(
                Step(
                    number,
                    choice.move,
                    (choice.expected.bits, choice.expected.error),
                    before.entropy - view.entropy,
                    view,
                    choice.options,
                    choice.ahead,
                    self.spent,
                    self._predicted() - count,
                    time.perf_counter() - began - waiting,
                )
            )
            self._report(self.steps[-1])

    def _give_up(self, move: Move, why: str) -> None:
        """Note that a pull cannot be made; it is not chosen again."""
        self.chooser.barred[move] = "it cannot be made"
        self.remarks.append(f"{move}: {why}")
        self.progress.say(self.remarks[-1])

    def _after(self, number: int, measurement: Measurement, view: PosteriorSummary) -> PosteriorSummary:
        """What is believed after a pull; what was before where no set can be followed in it."""
        felt = self.predictors[0].gripper is not None
        found = self.posterior.after(measurement if felt else measurement.without_forces())
        if found is None:
            self.remarks.append(f"pull {number}: cannot be compared: {self.posterior.failure}")
            self.progress.say(self.remarks[-1])
            return view
        return found

    def _examine(self, number: int, measurement: Measurement) -> None:
        """Note what is odd about what was seen."""
        for text in (*measurement.check(self.scene), *self._about_forces(measurement)):
            self.remarks.append(f"pull {number}: {text}")
            self.progress.say(f"look at this first: {self.remarks[-1]}")

    def _about_forces(self, measurement: Measurement) -> list[str]:
        """Whether forces are measured that do not count, or not where they should."""
        felt, wanted = bool(np.isfinite(measurement.wrenches).any()), self.predictors[0].gripper is not None
        if felt == wanted:
            return []
        return ["holds no force of the gripper, which --wrench-noise announces" if wanted else _UNCOUNTED]

    def _choose(self, view: PosteriorSummary, last: Move | None) -> Choice:
        """The next pull; what was made before by an exploration that was interrupted comes again."""
        number = len(self.steps)
        known_first = self.first if number == 0 and not self.chooser.barred else None
        choice = known_first or self.chooser.choose(view, last)
        if number < len(self.made):
            move = self.made[number][0]
            known = next((o for o in choice.options if o.move == move), None)
            return Choice(move, known.expected if known else choice.expected, choice.options, choice.ahead)
        return choice

    def _pull(self, number: int, move: Move) -> Measurement:
        """Let the robot make a pull; the measurement on every rank."""
        if number <= len(self.made):
            return self.made[number - 1][1]

        def work() -> Measurement:
            assert self.robot is not None
            self.robot.move(move.action(limits_of(self.scene), str(number)))
            measurement = self.robot.observe()
            if measurement.cloud is not None:
                raise InputError(
                    f"{measurement.source}: holds points of the surface, which explore cannot use: its choices are about markers; "
                    "leave surface.csv out, or give the pulls to identify or explain"
                )
            if self.keep is not None:
                self.keep(move, measurement)
            return measurement

        return on_root(self.comm, work)

    def _rivals(self, view: PosteriorSummary) -> tuple[Hypothesis, ...]:
        """The hypotheses that are not told apart: those that hold the confidence that is asked for."""
        found: list[Hypothesis] = []
        mass = 0.0
        for hypothesis, p in view.probabilities.items():
            if mass >= self.options.confidence:
                break
            found.append(hypothesis)
            mass += p
        return tuple(found)

    def _predicted(self) -> int:
        return sum(p.evaluations for p in self.predictors)

    # -- in words
    # --------------------------------------------------------------------------------------------------------------

    def _announce(self, number: int, choice: Choice) -> None:
        bits = choice.expected.bits
        why = f"{bits:.2f} bits expected" if math.isfinite(bits) else "chosen at random"
        then = f", before {choice.ahead}" if choice.ahead else ""
        self.progress.say(f"pull {number}: {choice.move} ({why}{then})")

    def _report(self, step: Step) -> None:
        shown = ", ".join(
            f"{h.label(self.scene.patches)} {percent(p)}"
            for h, p in list(step.view.probabilities.items())[:3]
            if p > 1e-3
        )
        doubt = ""
        if step.view.missing >= THRESHOLDS.credible:
            doubt = f"; SOMETHING IS MISSING ({percent(step.view.missing)})"
        self.progress.say(f"  {step.gained:.2f} bits gained; {shown}{doubt}; {step.seconds:.1f} s of computing")
