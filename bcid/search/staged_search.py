"""Algorithms 1 and 2 of Boonvisut & Cavusoglu (2014): anchor sets are climbed to on a coarse mesh, and followed up the ladder.

A set that is stopped has lost: sets are compared as they are followed, frame by frame (`bcid.search.screening`). What those that
remain are worth is for the posterior to say (`bcid.comparison.identify`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from bcid.base.collective import Comm
from bcid.base.errors import SolveError
from bcid.base.progress import Progress, Silent
from bcid.forms.mesh.patches import divided, first_level
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.continuation import ContinuationError
from bcid.inference.outcome import Candidate, Outcome, label
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Measurement
from bcid.scene import Scene
from bcid.search.climb import climb, neighbours, rank
from bcid.search.evaluator import Evaluator
from bcid.search.screening import finest, level_errors, log_odds, rejection_bound, screened
from bcid.search.seeds import above, maxima, perturbed, random_seeds
from bcid.search.settings import SETTINGS
from bcid.search.stage_options import GROUP, StageOptions
from bcid.search.termination import SETTLED


@dataclass(frozen=True)
class StagedSets:
    """What the stages found.

    Attributes:
        best: the set that fits best on the last level.
        shares: of all visited sets as screening sees them, the largest first; they sum to one.
        lost: sets that are `SearchSettings.odds` times less likely than the best on the finest level that they came to.
        errors: RMS error of the model on each level used, m.
        stages: what happened on each level, in words.
        evaluations: forward trajectories per level, in whole-trajectory equivalents.
    """

    best: Outcome
    shares: Mapping[Candidate, float]
    lost: frozenset[Candidate]
    errors: Mapping[int, float]
    stages: tuple[str, ...]
    evaluations: Mapping[int, float]

    @property
    def levels(self) -> tuple[int, ...]:
        """The levels used, the coarsest first."""
        return tuple(self.errors)

    @property
    def likely(self) -> list[Candidate]:
        """The sets that have not lost, the likeliest first."""
        return [c for c in self.shares if c not in self.lost]


def staged_search(
    scene: Scene,
    measurement: Measurement,
    comm: Comm,
    options: StageOptions,
    model: Model | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
    start: Sequence[Candidate] = (),
) -> StagedSets:
    """The likely sets; collective on `comm`.

    Args:
        scene: body, candidate patches (divided ones are replaced by their pieces), mesh ladder.
        measurement: fiducial trajectories and gripper motion; must fit the scene.
        comm: MPI communicator over which candidates are spread.
        options: how to search.
        model: the model; by default the scene's.
        settings: accuracy and patience of the solver.
        progress: told what is going on (give it on rank 0 only).
        start: sets to climb from on the first level, instead of random ones.

    Raises:
        InputError: scene, measurement or options do not fit each other.
        ContinuationError: the forward model failed for every set.
    """
    scene = divided(scene, comm)
    options.check(scene)
    level, passed = first_level(scene, options.coarsest, options.last(scene), comm)
    evaluator = Evaluator(scene, measurement, comm, model, settings, progress)
    try:
        # A level that is passed over counts as climbed on: climbing on a finer one instead would cost many times as much.
        climbed = max(1, options.coarsest + options.climbed - level)
        search = StagedSearch(evaluator, replace(options, coarsest=level, climbed=climbed), progress or Silent(), start)
        for reason in passed:
            search.say(f"not used: {reason}")
        return search.run()
    finally:
        evaluator.destroy()


class StagedSearch:
    """The stages of one search; `run` is collective on the ranks of the evaluator.

    Args:
        evaluator: evaluates sets on the levels of a scene.
        options: how the search is done; every level from the coarsest on shows all patches.
        progress: told what goes on (give it on rank 0 only).
        start: sets to climb from on the first level, instead of random ones.
    """

    def __init__(
        self,
        evaluator: Evaluator,
        options: StageOptions,
        progress: Progress,
        start: Sequence[Candidate] = (),
    ) -> None:
        self.evaluator, self.options, self.progress, self.start = evaluator, options, progress, start
        self.rng = np.random.default_rng(options.random_state)
        self.stages: list[str] = []
        self.levels: list[int] = []

    def run(self) -> StagedSets:
        """The sets that are left on the last level."""
        options = self.options
        last = options.last(self.evaluator.scene)
        seeds: list[Candidate] = list(self.start)
        best: list[Outcome] = []
        for level in range(options.coarsest, last + 1):
            self.levels.append(level)
            try:
                seeds = self.search(level, seeds)
                best.append(self.best(level))
            except SolveError as error:
                # What a coarser level found stands; on this one the model has nothing to say.
                if not best:
                    raise
                self.levels.pop()
                self.say(f"not used: {error}")
                break
            self.note(level, best[-1])
            if level < last and self.ends(best):
                break
        return self.left(best[-1])

    def left(self, best: Outcome) -> StagedSets:
        """What is left once the `best` set of the last level is known on all levels."""
        self.complete(best)
        evaluator, errors = self.evaluator, level_errors(self.evaluator, best.candidate, self.levels)
        logs = screened(evaluator, best.candidate, errors)
        shares = softmax(list(logs.values()))
        lost = frozenset(c for c, log in logs.items() if log < -math.log(SETTINGS.odds))
        return StagedSets(
            best,
            dict(zip(logs, shares.tolist(), strict=True)),
            lost,
            errors,
            tuple(self.stages),
            evaluator.evaluations(),
        )

    def search(self, level: int, seeds: Sequence[Candidate]) -> list[Candidate]:
        """Search on one level, as the options say; returns the seeds of the next."""
        options = self.options
        following = self.climb(level, seeds) if level < options.coarsest + options.climbed else []
        self.promote(level)
        return following

    def say(self, text: str) -> None:
        self.stages.append(text)
        self.progress.say(text)

    def name(self, candidate: Candidate) -> str:
        return label(candidate, self.evaluator.patches)

    def best(self, level: int) -> Outcome:
        found = [o for (at, _), o in self.evaluator.outcomes.items() if at == level and o.complete]
        if not found:
            failed = [o for (at, _), o in self.evaluator.outcomes.items() if at == level and o.failed]
            message = (
                f"level {level}: the forward model failed for every anchor set tried; the first: {failed[0].reason}"
            )
            raise ContinuationError(message, "no anchor set can be followed", _furthest(failed))
        return min(found, key=rank)

    def note(self, level: int, best: Outcome) -> None:
        noise = self.evaluator.misfit.noise
        known = f", noise {noise * 1e3:.3g} mm" if noise is not None else ""
        count = self.evaluator.evaluations()[level]
        self.say(
            f"level {level}: best {self.name(best.candidate)}, residual {best.rms * 1e3:.3g} mm{known}; {count:.1f} trajectories"
        )

    def climb(self, level: int, seeds: Sequence[Candidate]) -> list[Candidate]:
        """Climb on a level, in groups of seeds; returns the seeds of the next level."""
        options, evaluator = self.options, self.evaluator
        if not seeds:
            seeds = random_seeds(evaluator.patches, options.seeds, self.rng)
        climbs = []
        unchanged = 0
        top: Outcome | None = None
        why = "all seeds are used"
        for i in range(0, len(seeds), GROUP):
            group = seeds[i : i + GROUP]
            climbs += climb(evaluator, level, group)
            now = self.best(level)
            unchanged = unchanged + len(group) if top is not None and now.candidate == top.candidate else 0
            top = now
            self.progress.step(f"level {level}: climbs", len(climbs), 0, f"best so far {self.name(now.candidate)}")
            reached = options.termination.reached(evaluator, level, now, unchanged)
            if reached:
                why = reached
                break
        self.say(f"level {level}: {len(climbs)} climbs ended on {len({c.top for c in climbs})} maxima; {why}")
        if options.start == "maxima":
            following = maxima(climbs, evaluator, level)
        else:
            following = above(evaluator, level, options.threshold * evaluator.misfit.similarity(self.best(level).rms))
        return perturbed(following, evaluator.patches, options.toggles, self.rng)

    def promote(self, level: int) -> None:
        """Carry every set that is not unlikely on a coarser level up to this one, one level at a time, until none is left behind.

        The neighbours of the best set are looked at too, on the finest level that is climbed on.
        """
        evaluator, options = self.evaluator, self.options
        if level > options.coarsest and not any(at == level for at, _ in evaluator.outcomes):
            evaluator.evaluate(level, {self.best(level - 1).candidate: math.inf})
        while True:
            best = self.best(level)
            for below in range(options.coarsest, level):
                evaluator.evaluate(below, {best.candidate: math.inf})
            climbed = min(level, options.coarsest + options.climbed - 1)
            around = rejection_bound(evaluator.outcomes[climbed, best.candidate], evaluator.misfit, SETTINGS.odds)
            evaluator.evaluate(climbed, dict.fromkeys(neighbours(best.candidate, evaluator.patches), around))
            errors = level_errors(evaluator, best.candidate, self.levels)
            waiting: dict[int, list[Candidate]] = {}
            for candidate, outcome in finest(evaluator, level).items():
                reference = evaluator.outcomes.get((outcome.level, best.candidate))
                if outcome.level < level and reference and (outcome.level + 1, candidate) not in evaluator.outcomes:
                    likely = log_odds(outcome, reference, evaluator.misfit, errors[outcome.level]) > math.log(
                        SETTINGS.alike
                    )
                    if likely:
                        waiting.setdefault(outcome.level + 1, []).append(candidate)
            if not waiting and self.best(level).candidate == best.candidate:
                return
            for target, candidates in sorted(waiting.items()):
                around = rejection_bound(
                    evaluator.outcomes[target, best.candidate], evaluator.misfit, SETTINGS.odds, errors.get(target, 0.0)
                )
                evaluator.evaluate(target, dict.fromkeys(candidates, around))

    def ends(self, best: list[Outcome]) -> bool:
        """Whether no finer level is needed."""
        stop = self.options.stop
        if stop.rule == SETTLED:
            return self.options.finest is None and len(best) > 1 and self.settled(best)
        why = stop.reached(self.evaluator, best)
        if why:
            self.say(f"level {best[-1].level} is the last: {why}")
        return why is not None

    def settled(self, best: Sequence[Outcome]) -> bool:
        """The set is decided with the error of this level counted, and the residual is the noise or no longer changes."""
        noise = self.evaluator.misfit.noise
        near = noise is not None and best[-1].rms <= 1.1 * noise
        if not near and abs(best[-1].rms - best[-2].rms) >= 0.05 * best[-1].rms:
            return False
        return self.left(best[-1]).shares[best[-1].candidate] >= 1 - THRESHOLDS.surprise

    def complete(self, winner: Outcome) -> None:
        """Evaluate the winner on every level used: the belief compares the others with it."""
        for level in self.levels:
            self.evaluator.evaluate(level, {winner.candidate: math.inf})


def _furthest(failed: Sequence[Outcome]) -> NDArray[np.bool_]:
    """The frames that half of the sets came to, or, where each fails in another action, those that one set came to."""
    came: NDArray[np.bool_] = np.isfinite(np.array([outcome.by_frame for outcome in failed]))
    half = np.asarray(came.mean(axis=0) >= 0.5)
    return np.asarray(came[came.sum(axis=1).argmax()]) if half.all() else half
