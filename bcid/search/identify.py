"""The main job: from a scene and a measurement to the anchored patches."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.base.errors import SolveError
from bcid.base.progress import Progress, Silent
from bcid.forms.mesh.patches import divided, first_level
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.continuation import ContinuationError
from bcid.inference.hypotheses import HypothesisOdds, patches
from bcid.inference.mesh_error import MeshError
from bcid.inference.outcome import Candidate, Outcome, label
from bcid.measurement import Measurement
from bcid.scene import Scene
from bcid.search.climb import ODDS, climb, neighbours, rank
from bcid.search.evaluator import Evaluator
from bcid.search.evidence_evaluator import EvidenceEvaluator, Weight
from bcid.search.identification import Alternative, Identification
from bcid.search.identify_options import GROUP, IdentifyOptions
from bcid.search.screening import classes, finest, level_errors, log_odds, rejection_bound, screened
from bcid.search.seeds import above, all_candidates, maxima, perturbed, random_seeds
from bcid.search.set_evidence import SetEvidence
from bcid.search.termination import SETTLED

# A set this much less likely than the best on a coarser level is not carried to the next.
_LEAST = math.log(1e-4)
# The ladder goes on while the best set is less probable than this.
_DECIDED = 0.99


def identify(
    scene: Scene,
    measurement: Measurement,
    comm: Comm | None = None,
    options: IdentifyOptions | None = None,
    model: Model | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
    known: Iterable[Outcome] = (),
    keep: Callable[[list[Outcome]], None] | None = None,
    start: Sequence[Candidate] = (),
    mesh: MeshError | None = None,
) -> Identification:
    """Find the anchored patches; collective on `comm`, with the same result for any number of ranks.

    Args:
        scene: body, candidate patches (divided ones are replaced by their pieces), mesh ladder.
        measurement: fiducial trajectories and gripper motion; must fit the scene.
        comm: MPI communicator over which candidates are spread; COMM_SELF by default.
        options: how to search.
        model: the model; by default the scene's.
        settings: accuracy and patience of the solver.
        progress: told what is going on (give it on rank 0 only).
        known: outcomes of an interrupted search with the same input: they are not computed again.
        keep: called with the outcomes of each batch as they come, on every rank.
        start: sets to climb from on the first level, instead of random ones.
        mesh: what is left of the error of the mesh, where that is known and a single level is used.

    Raises:
        InputError: scene, measurement or options do not fit each other.
        ContinuationError: the forward model failed for every set.
    """
    from mpi4py import MPI

    options, comm = options or IdentifyOptions(), comm or MPI.COMM_SELF
    scene = divided(scene, comm)
    options.check(scene)
    level, passed = first_level(scene, options.coarsest, options.last(scene), comm)
    evaluator = Evaluator(scene, measurement, comm, model, settings, progress, keep, known)
    try:
        # A level that is passed over counts as climbed on: climbing on a finer one instead would cost many times as much.
        climbed = max(1, options.coarsest + options.climbed - level)
        chosen = replace(options, coarsest=level, climbed=climbed)
        search = _Search(evaluator, chosen, progress or Silent(), start, partial(EvidenceEvaluator, mesh=mesh))
        for reason in passed:
            search.say(f"not used: {reason}")
        found = replace(search.run(), remarks=evaluator.measurement.remarks)
    finally:
        evaluator.destroy()
    if not found.astray or mesh is not None:
        # Where the mesh is known effects are looked for, and a fiducial that goes astray is one of them.
        return replace(found, astray=())
    # Whoever goes astray has led the search astray as well.
    others = measurement.without(found.astray)
    again = identify(scene, others, comm, options, model, settings, progress, start=start)
    return replace(again, remarks=found.remarks, astray=(*found.astray, *again.astray))


class _Search:
    """The stages of one identification."""

    def __init__(
        self,
        evaluator: Evaluator,
        options: IdentifyOptions,
        progress: Progress,
        start: Sequence[Candidate] = (),
        weighing: Callable[[Evaluator, Sequence[int], Candidate], EvidenceEvaluator] | None = None,
    ) -> None:
        self.evaluator, self.options, self.progress, self.start = evaluator, options, progress, start
        self.weighing = weighing
        self.rng = np.random.default_rng(options.random_state)
        self.stages: list[str] = []
        self.levels: list[int] = []

    def run(self) -> Identification:
        start = time.perf_counter()
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
        if options.certifies(self.evaluator.scene):
            best[-1] = self.certify(best[-1])
        return self.result(best, time.perf_counter() - start)

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

    def names(self, candidate: Candidate) -> tuple[str, ...]:
        """The patches of a set in the scene's order."""
        return tuple(patch for patch in self.evaluator.patches if patch in candidate)

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
            seeds = random_seeds(evaluator.patches, options.count(evaluator.scene), self.rng)
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

    def certify(self, winner: Outcome) -> Outcome:
        """Look at every set of patches on the winner's level, those first that differ least from it; returns the best.

        A set stops as soon as all such sets together are `ODDS` times less likely than the winner.
        """
        evaluator, level = self.evaluator, winner.level
        everything = all_candidates(evaluator.patches)
        best: Outcome | None = None
        while best is None or best.candidate != winner.candidate:
            winner = best or winner
            self.complete(winner)
            error = level_errors(evaluator, winner.candidate, self.levels)[level]
            bound = rejection_bound(winner, evaluator.misfit, ODDS * len(everything), error)
            rivals = sorted(everything, key=lambda c: (len(c ^ winner.candidate), sorted(c)))
            evaluator.evaluate(level, dict.fromkeys(rivals, bound), rival=winner.candidate, last=True)
            best = self.best(level)
        self.say(
            f"level {level}: all {len(everything)} sets looked at; {evaluator.evaluations()[level]:.1f} trajectories"
        )
        return winner

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
            around = rejection_bound(evaluator.outcomes[climbed, best.candidate], evaluator.misfit, ODDS)
            evaluator.evaluate(climbed, dict.fromkeys(neighbours(best.candidate, evaluator.patches), around))
            errors = level_errors(evaluator, best.candidate, self.levels)
            waiting: dict[int, list[Candidate]] = {}
            for candidate, outcome in finest(evaluator, level).items():
                reference = evaluator.outcomes.get((outcome.level, best.candidate))
                if outcome.level < level and reference and (outcome.level + 1, candidate) not in evaluator.outcomes:
                    likely = log_odds(outcome, reference, evaluator.misfit, errors[outcome.level]) > _LEAST
                    if likely:
                        waiting.setdefault(outcome.level + 1, []).append(candidate)
            if not waiting and self.best(level).candidate == best.candidate:
                return
            for target, candidates in sorted(waiting.items()):
                around = rejection_bound(
                    evaluator.outcomes[target, best.candidate], evaluator.misfit, ODDS, errors.get(target, 0.0)
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
        self.complete(best[-1])
        belief = screened(
            self.evaluator, best[-1].candidate, level_errors(self.evaluator, best[-1].candidate, self.levels)
        )
        return belief.held_by(best[-1].candidate) >= _DECIDED

    def complete(self, winner: Outcome) -> None:
        """Evaluate the winner on every level used: the belief compares the others with it."""
        for level in self.levels:
            self.evaluator.evaluate(level, {winner.candidate: math.inf})

    def result(self, best: list[Outcome], seconds: float) -> Identification:
        evaluator, nearest = self.evaluator, best[-1]
        self.complete(nearest)
        errors = level_errors(evaluator, nearest.candidate, self.levels)
        scales = self.weighing(evaluator, self.levels, nearest.candidate) if self.weighing else None
        try:
            weights = self.weigh(scales, nearest, errors) if scales else SetEvidence()
            weighed = weights.logs
            winner = self.likeliest(weighed, nearest, scales)
            known = scales is not None and bool(weighed) and scales.followed(winner)
            weight = scales.weight(scales.levels[-1], winner) if scales and known else None
            alike = scales.classes(scales.levels[-1], _likely(weighed)) if scales and weighed else None
            astray = scales.astray(scales.levels[-1], winner) if scales and known else ()
        finally:
            if scales:
                scales.destroy()
        outcome = evaluator.evaluate(nearest.level, {winner: math.inf})[winner]
        self.complete(outcome)
        belief = screened(evaluator, nearest.candidate, errors, weights)
        if alike is None:
            alike = classes(evaluator, nearest.level, errors[nearest.level], ODDS)
        return Identification(
            anchored=self.names(winner),
            probability=belief.held_by(winner),
            patches=patches(belief.probabilities, evaluator.patches),
            rms=outcome.rms,
            noise=evaluator.misfit.noise,
            discretisation=self.discretisation(errors, nearest, weight),
            certified=self.certified(nearest.level),
            evaluations=evaluator.evaluations(),
            looked_at=self.looked_at(nearest.level),
            alternatives=self.alternatives(belief, outcome),
            classes=tuple(tuple(self.names(c) for c in members) for members in alike),
            levels=tuple(self.levels),
            stages=tuple(self.stages),
            prediction=evaluator.predict(nearest.level, winner),
            failures={
                self.name(c): o.reason for (_, c), o in sorted(evaluator.outcomes.items(), key=_order) if o.failed
            },
            seconds=seconds,
            missing=weight.evidence.missing if weight else None,
            nuisances=tuple(weight.told) if weight else (),
            stiffness=weight.stiffness(evaluator.model) if weight else None,
            astray=astray,
        )

    def likeliest(
        self, weighed: dict[Candidate, float], nearest: Outcome, scales: EvidenceEvaluator | None
    ) -> Candidate:
        """The set that is reported: of those that can be followed to the end."""
        for candidate in sorted(weighed, key=lambda c: (-weighed[c], len(c), sorted(c))):
            complete = self.evaluator.evaluate(nearest.level, {candidate: math.inf})[candidate].complete
            if complete and scales is not None and scales.followed(candidate):
                return candidate
        return nearest.candidate

    def weigh(self, scales: EvidenceEvaluator, nearest: Outcome, errors: dict[int, float]) -> SetEvidence:
        """Logarithms of the evidence of the sets that may be the one."""
        evaluator = self.evaluator

        def log(outcome: Outcome) -> float:
            best = evaluator.outcomes[outcome.level, nearest.candidate]
            return log_odds(outcome, best, evaluator.misfit, errors[outcome.level])

        known = {c: (-log(o), rank(o)) for c, o in finest(evaluator, self.levels[-1]).items()}
        weighed = scales.run(sorted(known, key=lambda c: known[c]), lambda c: neighbours(c, evaluator.patches))
        if weighed.finely:
            self.say(
                f"{len(weighed.logs)} sets weighed with what the scene may have slightly wrong and with an unknown force"
            )
        return weighed

    def discretisation(self, errors: dict[int, float], nearest: Outcome, weight: Weight | None) -> float | None:
        """RMS error of the model on the last level, m, or None where only one level was solved."""
        if sum(not self.evaluator.outcomes[level, nearest.candidate].failed for level in self.levels) < 2:
            return None
        return weight.errors.mesh_rms if weight else errors[nearest.level]

    def looked_at(self, level: int) -> dict[str, int]:
        """What became of all sets of patches on a level."""
        here = [o for (at, _), o in self.evaluator.outcomes.items() if at == level]
        complete, failed = sum(o.complete for o in here), sum(o.failed for o in here)
        every = 2 ** len(self.evaluator.patches)
        return {
            "in full": complete,
            "stopped": len(here) - complete - failed,
            "failed": failed,
            "not": every - len(here),
        }

    def certified(self, level: int) -> bool:
        """Whether every set was looked at on a level, and the model could be solved for each."""
        counts = self.looked_at(level)
        return not counts["failed"] and not counts["not"]

    def alternatives(self, belief: HypothesisOdds, winner: Outcome, count: int = 8) -> tuple[Alternative, ...]:
        evaluator = self.evaluator
        others = [o for c, o in finest(evaluator, self.levels[-1]).items() if c != winner.candidate]
        others = [o for o in others if (o.level, winner.candidate) in evaluator.outcomes]
        likely = sorted(others, key=lambda o: (-belief.held_by(o.candidate), rank(o)))
        return tuple(
            self.alternative(o, evaluator.outcomes[o.level, winner.candidate], belief.held_by(o.candidate))
            for o in likely[:count]
        )

    def alternative(self, other: Outcome, best: Outcome, probability: float) -> Alternative:
        """A set beside the best one, both on the same level."""
        both = np.isfinite(other.by_frame) & np.isfinite(best.by_frame)
        misses, at_best = (self.evaluator.misfit.rms_of(o.by_frame, both) for o in (other, best))
        return Alternative(
            self.names(other.candidate),
            probability,
            misses,
            other.level,
            not (other.complete or other.failed),
            at_best,
            int(both.sum()),
            other.reason,
        )


def _likely(logs: dict[Candidate, float]) -> dict[Candidate, float]:
    """The sets that are not `ODDS` times less likely than the best."""
    return {c: log for c, log in logs.items() if log > -math.log(ODDS)}


def _furthest(failed: Sequence[Outcome]) -> NDArray[np.bool_]:
    """The frames that half of the sets came to, or, where each fails in another action, those that one set came to."""
    came: NDArray[np.bool_] = np.isfinite(np.array([outcome.by_frame for outcome in failed]))
    half = np.asarray(came.mean(axis=0) >= 0.5)
    return np.asarray(came[came.sum(axis=1).argmax()]) if half.all() else half


def _order(item: tuple[tuple[int, Candidate], Outcome]) -> tuple[int, int, list[str]]:
    (level, candidate), _ = item
    return level, len(candidate), sorted(candidate)
