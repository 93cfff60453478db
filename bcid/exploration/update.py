"""From pulls that were seen to a belief: predict them with the sets that matter, take out the error of the mesh, compare."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.exploration.predictions import Anchored, PullPrediction, PullPredictor
from bcid.exploration.rival_effects import Fitted, RivalEffects
from bcid.inference.hypotheses import Belief, Hypothesis, Spread, effects, entropy, normalised, patches
from bcid.inference.mesh_error import MeshError
from bcid.inference.misfit import Misfit
from bcid.measurement import Action, Measurement
from bcid.scene import Scene
from bcid.scene.rotation import as_rotation
from bcid.search.climb import neighbours
from bcid.search.seeds import all_candidates, random_seeds

Array = NDArray[np.float64]
# All sets of so many patches are hypotheses; of more, those that a climb comes to from random ones.
_ENUMERATED, _RANDOM = 10, 64
# A set whose odds against the best are below exp(-_ASLEEP) is not predicted for further pulls, unless its odds recover.
_ASLEEP = 25.0
# Sets with more than this probability are compared on the fine level too, so many at most, and their neighbours looked at.
_CONTENDS, _CONTENDERS = 0.01, 4
# A body that may buckle in a pull is taken to go anywhere within this part of its motion.
_ANYWHERE = 0.5
# Between levels that hardly differ nothing can be extrapolated.
_LEAST_GAIN = 0.5
# Before anything was seen the error of the mesh is taken as this part of the motion.
_FIRST_ERROR = 0.03
# Before any pull it is as likely that no effect acts as that one of the rivals does.
NONE = 0.5
# The best set misses what was seen by more than this many times what noise and mesh explain: no set does explain it.
MISSED = 1.5


@dataclass(frozen=True)
class Pulled:
    """A pull that was seen.

    Attributes:
        action: as the gripper really moved; frames numbered from 0.
        misfit: the comparison with what was seen.
        profile: part of the motion that is done in each frame.
        motion: RMS motion of the fiducials, m.
    """

    action: Action
    misfit: Misfit
    profile: Array
    motion: float

    @classmethod
    def of(cls, scene: Scene, measurement: Measurement) -> Pulled:
        """From a measurement that holds one action."""
        action, misfit = measurement.actions[0], Misfit(scene, measurement)
        return cls(action, misfit, profile(action, scene), misfit.motion_rms)


@dataclass(frozen=True)
class Meshed:
    """What the fine level says of a prediction: what to add to it, (frames, fiducials, 3), m, and the RMS of what is left, m."""

    correction: Array
    left: float


def profile(action: Action, scene: Scene) -> Array:
    """Distance of the gripper from rest in each frame, as part of the largest; shape (frames,).

    A turn counts by how far it would move the nearest fiducial.
    """
    far = scene.rest - np.array(scene.grasps[action.grasp].centre) if action.grasp else np.zeros((1, 3))
    turned = (as_rotation(action.rotation) * as_rotation(action.rotation[0]).inv()).magnitude()
    way = np.linalg.norm(action.translation, axis=1) + turned * np.linalg.norm(far, axis=1).min()
    return np.asarray(way / max(float(way.max()), 1e-12))


@dataclass(frozen=True)
class PosteriorSummary:
    """What is believed after some pulls.

    Attributes:
        probabilities: of every hypothesis looked at, the likeliest first.
        patches: probability that each patch is anchored.
        effects: probability of each rival effect, and of none ("").
        entropy: bits.
        rms: RMS residual of the likeliest hypothesis, m; NaN before anything was seen.
        missed: the same in units of what noise and mesh explain.
        error: RMS error of the mesh at the end of a pull, as part of its motion.
        fitted: the hypotheses with an effect, with their numbers.
    """

    probabilities: dict[Hypothesis, float]
    patches: dict[str, float]
    effects: dict[str, float]
    entropy: float
    rms: float
    missed: float
    error: float
    fitted: dict[Hypothesis, Fitted] = field(default_factory=dict)

    @property
    def best(self) -> Hypothesis:
        """The likeliest hypothesis."""
        return next(iter(self.probabilities))

    @property
    def certainty(self) -> float:
        """Its probability."""
        return self.probabilities[self.best]


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
        self.pulls: list[Pulled] = []
        self.seen: list[Measurement] = []
        # By pull and set: predictions, the error of the mesh where it is known, chi-square and volume of the errors.
        self._predicted: list[dict[Anchored, PullPrediction]] = []
        self._meshed: list[dict[Anchored, Meshed]] = []
        self._compared: dict[int, dict[Anchored, tuple[float, float]]] = {}
        # The hypotheses that were fitted, and to how many pulls.
        self._fitted: tuple[int, list[Fitted]] = 0, []
        # What chi-squares are divided by.
        self._scale = 1.0

    def add(self, measurement: Measurement) -> None:
        """Take what was seen of a pull."""
        self.pulls.append(Pulled.of(self.scene, measurement))
        self.seen.append(measurement)
        self._predicted.append({})
        self._meshed.append({})

    def view(self) -> PosteriorSummary:
        """What is believed now."""
        view = self._look()
        while self.pulls and (self._wake() or self._grow() or self._fit() or self._refine(view)):
            view = self._look()
        return view

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

    def _wake(self) -> bool:
        """Predict what is not known of sets that are not asleep; whether there was anything."""
        relative = self._belief(self._scale).relative()
        awake = [a for a in self.sets if relative.get(a, 0.0) > -_ASLEEP]
        todo = [(i, a) for i in range(len(self.pulls)) for a in awake if a not in self._predicted[i]]
        found = self.predictor.predict((a, self.pulls[i].action) for i, a in todo)
        self._take(zip(todo, found, strict=True))
        return bool(todo)

    def _take(self, found: Iterable[tuple[tuple[int, Anchored], PullPrediction]]) -> None:
        """Keep predictions; what was compared with the pulls they belong to is no longer true."""
        for key, predicted in found:
            self._predicted[key[0]][key[1]] = predicted
            self._compared.pop(key[0], None)

    def _fit(self) -> bool:
        """Fit the rival effects to all pulls, each with the sets that go with it; whether that was not done yet."""
        if self.rivals is None or self._fitted[0] == len(self.pulls):
            return False
        self._fitted = len(self.pulls), self.rivals.look(self.seen, self._contending())
        return True

    def _grow(self) -> bool:
        """Take the neighbours of sets that contend among the hypotheses; whether there was any."""
        near = [n for a in self._contending() for n in neighbours(a, list(self.scene.patches))]
        fresh = [n for n in near if n not in self.sets]
        self.sets |= dict.fromkeys(fresh)
        return bool(fresh)

    def _refine(self, view: PosteriorSummary) -> bool:
        """Predict the sets that contend on the fine level, and whether the body may buckle with them; whether there was any."""
        todo = [(i, a) for i in range(len(self.pulls)) for a in self._contending()]
        if view.missed > MISSED:
            # Where nothing explains what was seen, the body may have buckled with any of the sets.
            todo = [(i, a) for i in range(len(self.pulls)) for a in self.sets]
        soft = [(i, a) for i, a in todo if a in self._predicted[i] and not self._predicted[i][a].detailed]
        found = self.predictor.predict(((a, self.pulls[i].action) for i, a in soft), detailed=True)
        self._take(zip(soft, found, strict=True))
        rough = [(i, a) for i in range(len(self.pulls)) for a in self._contending() if a not in self._meshed[i]]
        if self.fine is not None and rough:
            finely = self.fine.predict((a, self.pulls[i].action) for i, a in rough)
            for (i, a), predicted in zip(rough, finely, strict=True):
                self._meshed[i][a] = self._mesh_error(i, a, predicted)
                self._compared.pop(i, None)
            return True
        return bool(soft)

    def _mesh_error(self, pull: int, anchors: Anchored, finely: PullPrediction) -> Meshed:
        """From the predictions of both levels; where the fine one fails the working one may be anywhere."""
        if finely.failed:
            return Meshed(np.zeros((1, 1, 1)), _ANYWHERE * self.pulls[pull].motion)
        error = MeshError.between(self._predicted[pull][anchors].positions, finely.positions, self._gain)
        return Meshed(error.correction, error.rms)

    def _contending(self) -> list[Anchored]:
        """The likely sets, where no effect acts."""
        known = normalised({Hypothesis(a): value for a, value in self._belief(None).relative().items()})
        return [h.anchors for h, p in known.items() if p > _CONTENDS][:_CONTENDERS]

    # -- what they say
    # --------------------------------------------------------------------------------------------------------------

    def _look(self) -> PosteriorSummary:
        """What the pulls say as far as they were predicted; before the first one nothing is known."""
        best = self._best()
        names = self.rivals.names if self.rivals else ()
        if best is None:
            even = {Hypothesis(a): 1.0 / len(self.sets) for a in self.sets}
            prior = believed(names)
            bits = math.log2(len(self.sets)) + entropy(prior.values())
            return PosteriorSummary(even, patches(even, self.scene.patches), prior, bits, math.nan, 0.0, _FIRST_ERROR)
        fitted = self._fitted[1] if self._fitted[0] == len(self.pulls) else []
        top = max(fitted, key=lambda f: f.log(1.0), default=None)
        if top is not None and top.hypothesis.effect:
            rms, missed = top.rms, top.missed
        else:
            rms, missed = self._rms(best), self._missed(best)
        # What no hypothesis explains makes all of them less sure of themselves.
        scale = self._scale = max(1.0, missed**2)
        logs = {Hypothesis(a): value for a, value in self._belief(scale).relative().items()}
        plain = [f for f in fitted if not f.hypothesis.effect and f.hypothesis in logs]
        acting = {f.hypothesis: f for f in fitted if f.hypothesis.effect} if plain else {}
        if acting:
            # Both know the best set: through it the sets alone and those with an effect are compared.
            shared = max(plain, key=lambda f: logs[f.hypothesis])
            apart = logs[shared.hypothesis] - shared.log(scale) + math.log(believed(names)[names[0]] / NONE)
            logs |= {h: f.log(scale) + apart for h, f in acting.items()}
        known = normalised(logs)
        return PosteriorSummary(
            known,
            patches(known, self.scene.patches),
            effects(known, names),
            entropy(known.values()),
            rms,
            missed,
            self._relative_error(best),
            acting,
        )

    def _belief(self, scale: float | None) -> Belief:
        """Odds of the sets, with all chi-squares divided by `scale`; by default by what the best set leaves."""
        best, belief = self._best(), Belief()
        if best is None:
            return belief
        scale = max(1.0, self._missed(best) ** 2) if scale is None else scale
        for i in self._looked_at:
            belief.add(i, {a: -0.5 * chi2 / scale - volume for a, (chi2, volume) in self._compare(i).items()})
        return belief

    @property
    def _looked_at(self) -> list[int]:
        """The pulls that something was predicted for."""
        return [i for i, known in enumerate(self._predicted) if known]

    def _missed(self, anchors: Anchored) -> float:
        """What a set misses in units of its errors."""
        values = sum(self.pulls[i].misfit.values for i in self._looked_at)
        return math.sqrt(sum(self._compare(i)[anchors][0] for i in self._looked_at) / values)

    def _rms(self, anchors: Anchored) -> float:
        """What a set misses, m."""
        values = sum(self.pulls[i].misfit.values for i in self._looked_at)
        squares = sum(float(np.nansum(self._differences(i, anchors) ** 2)) for i in self._looked_at)
        return math.sqrt(squares / values)

    def _compare(self, pull: int) -> dict[Anchored, tuple[float, float]]:
        """Chi-square and logarithm of the volume of the errors of every set that was predicted for a pull."""
        if pull not in self._compared:
            found = {}
            for anchors, predicted in self._predicted[pull].items():
                if predicted.failed:
                    found[anchors] = math.inf, 0.0
                    continue
                spread, difference = self.spread(pull, anchors), self._differences(pull, anchors)
                chi2 = float(np.sum(spread.whiten(difference) ** 2))
                found[anchors] = chi2, spread.log_volume(np.isfinite(difference))
            self._compared[pull] = found
        return self._compared[pull]

    def _best(self) -> Anchored | None:
        """The likeliest of the sets that were compared with all pulls that were looked at."""
        compared = [self._compare(i) for i in self._looked_at]
        total: dict[Anchored, float] = {}
        for anchors in self.sets if compared else ():
            if all(anchors in found for found in compared):
                total[anchors] = sum(0.5 * found[anchors][0] + found[anchors][1] for found in compared)
        solved = {a: value for a, value in total.items() if math.isfinite(value)}
        return min(solved, key=lambda a: (solved[a], len(a), sorted(a)), default=None)

    def _differences(self, pull: int, anchors: Anchored) -> Array:
        """Seen minus predicted, with the error of the mesh taken out, (frames, fiducials, 3), m; NaN where nothing was seen."""
        seen = self.pulls[pull]
        return np.asarray(
            seen.misfit.measured - self._predicted[pull][anchors].positions - self._mesh(pull, anchors).correction
        )

    def spread(self, pull: int, anchors: Anchored) -> Spread:
        """Errors of a pull about a set's prediction."""
        seen, predicted = self.pulls[pull], self._predicted[pull][anchors]
        error = self._mesh(pull, anchors).left
        if predicted.detailed and predicted.buckles:
            error = max(error, _ANYWHERE * seen.motion)
        return Spread(seen.profile, seen.misfit.noise or 0.0, error)

    def _mesh(self, pull: int, anchors: Anchored) -> Meshed:
        """Error of the mesh in a pull: of the set itself, or of the set most like it of which it is known."""
        known = self._meshed[pull]
        if anchors in known or not known:
            return known.get(anchors, Meshed(np.zeros((1, 1, 1)), 0.0))
        return known[min(known, key=lambda a: (len(a ^ anchors), sorted(a)))]

    @cached_property
    def _gain(self) -> float:
        """How many times the difference of the levels exceeds the error of the fine one, at second order; collective."""
        assert self.fine is not None
        coarse, fine = (p.forward().body.unknowns for p in (self.predictor, self.fine))
        return max(float((fine / coarse) ** (2 / 3)) - 1, _LEAST_GAIN)

    def _relative_error(self, best: Anchored) -> float:
        """RMS error that the mesh leaves, as part of the motion, over all pulls."""
        if self.fine is None:
            return 0.0
        known = [self._mesh(i, best).left / max(p.motion, 1e-12) for i, p in enumerate(self.pulls) if self._meshed[i]]
        return float(np.mean(known)) if known else _FIRST_ERROR


def believed(names: Sequence[str]) -> dict[str, float]:
    """Probability of each effect, and of none (""), before any pull."""
    return {"": NONE if names else 1.0} | dict.fromkeys(names, (1 - NONE) / max(len(names), 1))


def weights(probabilities: Mapping[Hypothesis, float], hypotheses: Iterable[Hypothesis]) -> Array:
    """Probabilities of some hypotheses, summing to one."""
    found = np.array([probabilities[h] for h in hypotheses])
    return np.asarray(found / found.sum())
