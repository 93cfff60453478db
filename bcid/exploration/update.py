"""From pulls that were seen to a belief: predict them with the sets that matter, take out the error of the mesh, compare."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.exploration import pull_tangent
from bcid.exploration.posterior_summary import PosteriorSummary
from bcid.exploration.predictions import Anchored, PullPredictor, small_action
from bcid.exploration.pull_errors import ErrorModel, PullErrors, allowance
from bcid.exploration.pull_prediction import PullPrediction
from bcid.exploration.pull_tangent import PullTangent
from bcid.exploration.rival_effects import Fitted, RivalEffects
from bcid.inference.criteria import CREDIBLE_LEVEL
from bcid.inference.data import Data
from bcid.inference.hypotheses import Hypothesis, effects, entropy, normalised, patches
from bcid.inference.mesh_error import MeshError, gains
from bcid.inference.nuisances import NuisanceModes
from bcid.inference.stiffness import Stiffness
from bcid.measurement import Action, Measurement
from bcid.scene import Scene
from bcid.search.climb import neighbours
from bcid.search.seeds import all_candidates, random_seeds

Array = NDArray[np.float64]
# All sets of so many patches are hypotheses; of more, those that a climb comes to from random ones.
_ENUMERATED, _RANDOM = 10, 64
# The least likely sets, which hold no more than this of the probability together, are not predicted for further pulls, unless
# their odds recover. By Markov's inequality they would come to hold 5 % with no more than 20 times this probability.
_NEGLIGIBLE = 1e-5
# Where something may be missing odds are not worth as much: only those below exp(-_ASLEEP) against the best are not predicted.
_ASLEEP, _DOUBTED = 25.0, 0.5
# Sets with more than this probability are compared on the fine level too, so many at most, and their neighbours looked at.
_CONTENDS, _CONTENDERS = 0.01, 4
# Between levels that hardly differ nothing can be extrapolated.
# Before anything was seen the error of the mesh is taken as this part of the motion.
_FIRST_ERROR = 0.03
# Before any pull it is as likely that no effect acts as that one of the rivals does.
NONE = 0.5


class BeliefUpdate:
    """Bayes' rule over anchor sets. `view` is collective on the predictor's ranks, with the same result on all.

    Args:
        scene: the scene.
        predictor: of the working level.
        fine: of a finer level, from which the error of the working one is told; None if there is none.
        random_state: of the sets to begin with, where there are too many to look at all.
        rivals: the effects that may act besides; None where only the anchors are asked for.
    """

    def __init__(
        self,
        scene: Scene,
        predictor: PullPredictor,
        fine: PullPredictor | None,
        random_state: int = 0,
        rivals: RivalEffects | None = None,
    ) -> None:
        self.scene, self.predictor, self.fine, self.rivals = scene, predictor, fine, rivals
        names = list(scene.patches)
        if len(names) <= _ENUMERATED:
            sets = all_candidates(names)
        else:
            sets = random_seeds(names, _RANDOM, np.random.default_rng(random_state))
        self.sets: dict[Anchored, None] = dict.fromkeys(sets)
        self.pulls: list[Action] = []
        self.seen: list[Measurement] = []
        # By pull and set: predictions, and the error of the mesh where it is known; None where the fine level cannot be followed.
        self._predicted: list[dict[Anchored, PullPrediction]] = []
        self._meshes: list[dict[Anchored, MeshError | None]] = []
        self._errors: PullErrors | None = None
        # Odds of the sets and those that contended, before the last pull.
        self._before: dict[Anchored, float] = {}
        self._contended: list[Anchored] = []
        # The hypotheses that were fitted, and to how many pulls.
        self._fitted: tuple[int, list[Fitted]] = 0, []

    def add(self, measurement: Measurement) -> None:
        """Take what was seen of a pull; collective."""
        if self._errors is not None:
            self._before, self._contended = self._relative(), self._contending()
        self.pulls.append(measurement.actions[0])
        self.seen.append(measurement if self.predictor.gripper else measurement.without_forces())
        self._predicted.append({})
        self._meshes.append({})
        self._errors = PullErrors(self.scene, self.seen, self.predictor.force_unit, self.predictor.gripper)
        for pull, known in enumerate(self._predicted):
            self._tell({(pull, anchors): predicted for anchors, predicted in known.items()})

    def view(self) -> PosteriorSummary:
        """What is believed now."""
        while self.pulls and (self._wake() or self._refine() or self._grow() or self._fit() or self._doubt()):
            pass
        return self._look()

    @property
    def errors(self) -> PullErrors:
        """The errors of the pulls so far; there must have been one."""
        assert self._errors is not None
        return self._errors

    def predict(
        self,
        view: PosteriorSummary,
        hypotheses: Sequence[Hypothesis],
        action: Action,
        detailed: bool,
        fine: bool = False,
    ) -> list[PullPrediction]:
        """What hypotheses predict for an action, with what is not known of their numbers; collective.

        On the working level, or without what is not known on the fine one.
        """
        if fine:
            return self._finely(view, hypotheses, action, detailed)
        plain = [h for h in hypotheses if h not in view.fitted]
        found = dict(zip(plain, self.predictor.predict([(h.anchors, action) for h in plain], detailed), strict=True))
        acting = [h for h in hypotheses if h in view.fitted]
        if acting:
            found |= dict(zip(acting, self._loosely([view.fitted[h] for h in acting], action, detailed), strict=True))
        return [found[h] for h in hypotheses]

    def small_steps(
        self, view: PosteriorSummary, hypotheses: Sequence[Hypothesis], grasp: str, size: float
    ) -> list[PullPrediction]:
        """What hypotheses predict for a step of `size` (m) along each axis, as `predict` for `small_action`; collective."""
        plain = [h for h in hypotheses if h not in view.fitted]
        acting = [h for h in hypotheses if h in view.fitted]
        steps = self.predictor.small_steps([h.anchors for h in plain], grasp, size)
        found = dict(zip(plain, steps, strict=True))
        if acting:
            found |= dict(
                zip(acting, self.predict(view, acting, small_action(grasp, size), detailed=False), strict=True)
            )
        return [found[h] for h in hypotheses]

    def modes(self, view: PosteriorSummary, action: Action, data: Data, predicted: Array) -> NuisanceModes | None:
        """What the scene may have slightly wrong does to the values of a pull to come; collective.

        With the likeliest set, which predicts (frames, rows, 3), m. None where its tangent says nothing.
        """
        (tangent,) = self.predictor.differentiate([(view.best.anchors, action)], forces=False)
        if tangent is None:
            return None
        return pull_tangent.modes(self.predictor.nuisances, data, [tangent], self.predictor.model, predicted)

    def _finely(
        self, view: PosteriorSummary, hypotheses: Sequence[Hypothesis], action: Action, detailed: bool
    ) -> list[PullPrediction]:
        assert self.fine is not None
        models = [view.fitted[h].model if h in view.fitted else self.fine.model for h in hypotheses]
        return self.fine.predict([(h.anchors, action) for h in hypotheses], detailed, models)

    def _loosely(self, fitted: Sequence[Fitted], action: Action, detailed: bool) -> list[PullPrediction]:
        """What fitted hypotheses predict, and how that changes with their numbers."""
        tasks = [(f.hypothesis.anchors, action) for f in fitted]
        main = self.predictor.predict(tasks, detailed, [f.model for f in fitted])
        around = [(task, model) for task, f in zip(tasks, fitted, strict=True) for model in f.deviating]
        moved = iter(self.predictor.predict([task for task, _ in around], False, [model for _, model in around]))
        return [
            replace(one, loose=tuple(next(moved).positions - one.positions for _ in f.deviating))
            for one, f in zip(main, fitted, strict=True)
        ]

    # -- which sets are looked at
    # --------------------------------------------------------------------------------------------------------------

    def _relative(self) -> dict[Anchored, float]:
        """Logarithms of the odds of the sets; as before the last pull as long as nothing is known of its errors."""
        told = self.errors.allowed or (self._predicted[-1] and not any(map(self.errors.followed, self.sets)))
        if self._before and not told:
            return {a: self._before.get(a, 0.0) for a in self.sets}
        return self.errors.relative(list(self.sets))

    def _wake(self) -> bool:
        """Predict what is not known of sets that hold a part in the belief; whether there was anything."""
        return self._learn(active_sets(self._relative()))

    def _learn(self, sets: Iterable[Anchored]) -> bool:
        """Predict all pulls with sets, as far as that is not known; whether there was anything."""
        sets = list(sets)
        todo = [(i, a) for i in range(len(self.pulls)) for a in sets if a not in self._predicted[i]]
        found = self.predictor.predict((a, self.pulls[i]) for i, a in todo)
        self._tell(dict(zip(todo, found, strict=True)))
        return bool(todo)

    def _tell(self, found: Mapping[tuple[int, Anchored], PullPrediction]) -> None:
        """Keep predictions of sets for pulls."""
        for (pull, anchors), predicted in found.items():
            self._predicted[pull][anchors] = predicted
            adrift = predicted.detailed and predicted.buckles and not predicted.failed
            self.errors.predicted(anchors, pull, predicted.positions, adrift)

    def _contending(self) -> list[Anchored]:
        """The likely sets, where no effect acts, of those that were followed in all pulls; the likeliest first."""
        followed = [a for a in self.sets if self.errors.followed(a)]
        if not self.errors.allowed:
            # What can be told without their errors is which of those that contended before is the likeliest.
            first = [a for a in self._contended if a in followed] or followed
            odds = self.errors.relative(first)
            return sorted(odds, key=lambda a: (-odds[a], len(a), sorted(a)))[:1]
        known = normalised({Hypothesis(a): value for a, value in self._relative().items()})
        return [h.anchors for h, p in known.items() if p > _CONTENDS and self.errors.followed(h.anchors)][:_CONTENDERS]

    def _refine(self) -> bool:
        """Learn the errors about the sets that contend, where they are not known; whether there was any."""
        fresh = [a for a in self._contending() if a not in self.errors.allowed]
        every = [(i, a) for i in range(len(self.pulls)) for a in fresh]
        self._detail(every)
        if self.fine is not None:
            rough = [(i, a) for i, a in every if a not in self._meshes[i]]
            for (i, a), finely in zip(rough, self.fine.predict((a, self.pulls[i]) for i, a in rough), strict=True):
                self._meshes[i][a] = self._mesh_error(self._predicted[i][a], finely)
        tangents = dict(zip(every, self.predictor.differentiate((a, self.pulls[i]) for i, a in every), strict=True))
        for a in fresh:
            self.errors.allow(a, self._allowance(a, [tangents[i, a] for i in range(len(self.pulls))]))
        return bool(fresh)

    def _detail(self, asked: Iterable[tuple[int, Anchored]]) -> bool:
        """Learn whether the body may buckle in pulls with sets; whether there was any of which that was not known."""
        soft = [(i, a) for i, a in asked if a in self._predicted[i] and not self._predicted[i][a].detailed]
        found = self.predictor.predict(((a, self.pulls[i]) for i, a in soft), detailed=True)
        self._tell(dict(zip(soft, found, strict=True)))
        return bool(soft)

    def _allowance(self, anchors: Anchored, tangents: Sequence[PullTangent | None]) -> ErrorModel:
        """What is known of the errors about a set; where the tangent says nothing, neither nuisances nor an unknown force do."""
        data, places = self.errors.data, self.errors.places
        meshes = {i: known[anchors] for i, known in enumerate(self._meshes) if anchors in known}
        told = next((t for t in tangents if t is not None), None)
        if told is None:
            nothing = ErrorModel.nothing(data)
            return allowance(data, meshes, places, nothing.modes, nothing.unknown)
        shapes = [self.errors.data.measured[place].shape for place in places]
        whole = [t or pull_tangent.nothing(shape, told) for t, shape in zip(tangents, shapes, strict=True)]
        predicted = self.errors.predictions(anchors)
        modes = pull_tangent.modes(self.predictor.nuisances, data, whole, self.predictor.model, predicted)
        return allowance(data, meshes, places, modes, pull_tangent.unknown(data, whole, self.predictor.force_unit))

    def _mesh_error(self, working: PullPrediction, finely: PullPrediction) -> MeshError | None:
        """From the predictions of both levels; None where the fine one fails: there the body may go anywhere."""
        if finely.failed:
            return None
        assert self.fine is not None
        by = gains(self._refinement, self.fine.forward().body.degree, self.errors.data.kinds)
        return MeshError.between(working.positions, finely.positions, by)

    def _grow(self) -> bool:
        """Take the neighbours of sets that contend among the hypotheses; whether there was any."""
        near = [n for a in self._contending() for n in neighbours(a, list(self.scene.patches))]
        fresh = [n for n in near if n not in self.sets]
        self.sets |= dict.fromkeys(fresh)
        return bool(fresh)

    def _fit(self) -> bool:
        """Fit the rival effects to all pulls, each with the sets that go with it; whether that was not done yet."""
        if self.rivals is None or self._fitted[0] == len(self.pulls):
            return False
        self._fitted = len(self.pulls), self.rivals.look(self.seen, self._contending())
        return True

    def _doubt(self) -> bool:
        """Where something may be missing, predict unlikely sets too; where it is, whether the body may have buckled.

        Whether there was anything that was not known.
        """
        missing = self._look().missing
        if missing < _DOUBTED:
            return False
        relative = self._relative()
        if self._learn(a for a in self.sets if relative[a] > -_ASLEEP):
            return True
        return missing >= CREDIBLE_LEVEL and self._detail([(i, a) for i in range(len(self.pulls)) for a in self.sets])

    # -- what they say
    # --------------------------------------------------------------------------------------------------------------

    def _look(self) -> PosteriorSummary:
        """What the pulls say as far as they were predicted; before the first one nothing is known."""
        names = self.rivals.names if self.rivals else ()
        if not self.pulls:
            even = {Hypothesis(a): 1.0 / len(self.sets) for a in self.sets}
            prior = believed(names)
            bits = math.log2(len(self.sets)) + entropy(prior.values())
            return PosteriorSummary(even, patches(even, self.scene.patches), prior, bits, math.nan, 0, 0, _FIRST_ERROR)
        logs = {Hypothesis(a): value for a, value in self._relative().items()}
        acting = self._acting(logs)
        known = normalised(logs | acting)
        fitted = {f.hypothesis: f for f in self._fitted[1] if f.hypothesis in acting}
        rms, missed = self._misses(next(iter(known)), fitted)
        missing = math.fsum(p * self._missing(h, fitted) for h, p in known.items())
        error = self._relative_error(next(h.anchors for h in known if h not in acting))
        return PosteriorSummary(
            known,
            patches(known, self.scene.patches),
            effects(known, names),
            entropy(known.values()),
            rms,
            missed,
            missing,
            error,
            fitted,
            self._stiffness(next(iter(known)), fitted),
        )

    def _acting(self, logs: Mapping[Hypothesis, float]) -> dict[Hypothesis, float]:
        """Logarithms of the odds of the hypotheses with an effect, beside those of the sets alone.

        Both know the likeliest set: through it they are compared, with an unknown force as a rival besides; without one a set
        that misses what was seen by far would say little of the others.
        """
        if self.rivals is None or self._fitted[0] != len(self.pulls):
            return {}
        plain = [f for f in self._fitted[1] if not f.hypothesis.effect and f.hypothesis.anchors in self.errors.allowed]
        if not plain:
            return {}
        shared, prior = max(plain, key=lambda f: logs[f.hypothesis]), believed(self.rivals.names)
        apart = logs[shared.hypothesis] - shared.evidence.total
        found = {f.hypothesis: f.evidence.total + apart for f in self._fitted[1] if f.hypothesis.effect}
        return {h: value + math.log(prior[h.effect] / NONE) for h, value in found.items()}

    def _stiffness(self, best: Hypothesis, fitted: Mapping[Hypothesis, Fitted]) -> Stiffness | None:
        """How stiff the body is with the likeliest hypothesis, where forces are measured."""
        if best in fitted:
            return fitted[best].fitted.stiffness
        return self.errors.stiffness(best.anchors, self.predictor.model)

    def _missing(self, hypothesis: Hypothesis, fitted: Mapping[Hypothesis, Fitted]) -> float:
        """Probability that something is missing besides a hypothesis."""
        if hypothesis not in fitted:
            return self.errors.missing(hypothesis.anchors)
        return fitted[hypothesis].evidence.missing

    def _misses(self, best: Hypothesis, fitted: Mapping[Hypothesis, Fitted]) -> tuple[float, float]:
        """What the likeliest hypothesis misses, m, and in units of its errors; NaN where nothing can be predicted."""
        if best in fitted:
            return fitted[best].rms, fitted[best].missed
        return self.errors.rms(best.anchors), self.errors.missed(best.anchors)

    @cached_property
    def _refinement(self) -> float:
        """How many times smaller the elements of the fine level are; collective."""
        assert self.fine is not None
        coarse, fine = (p.forward().body.unknowns for p in (self.predictor, self.fine))
        return float((fine / coarse) ** (1 / 3))

    def _relative_error(self, likely: Anchored) -> float:
        """RMS error that the mesh leaves, as part of the motion, over all pulls."""
        if self.fine is None:
            return 0.0
        left = self.errors.left(likely)
        return _FIRST_ERROR if left is None else left


def active_sets(relative: Mapping[Anchored, float]) -> list[Anchored]:
    """All sets but the least likely, which hold a negligible part together; from logarithms of their odds."""
    order = sorted(relative, key=lambda a: (relative[a], -len(a), sorted(a)))
    odds = np.exp([relative[a] for a in order])
    asleep = set(order[: int(np.searchsorted(np.cumsum(odds), _NEGLIGIBLE * odds.sum(), side="right"))])
    return [a for a in relative if a not in asleep]


def believed(names: Sequence[str]) -> dict[str, float]:
    """Probability of each effect, and of none (""), before any pull."""
    return {"": NONE if names else 1.0} | dict.fromkeys(names, (1 - NONE) / max(len(names), 1))


def weights(probabilities: Mapping[Hypothesis, float], hypotheses: Iterable[Hypothesis]) -> Array:
    """Probabilities of some hypotheses, summing to one."""
    found = np.array([probabilities[h] for h in hypotheses])
    return np.asarray(found / found.sum())
