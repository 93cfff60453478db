"""From pulls that were seen to a belief: predict them with the sets that matter, take out the error of the mesh, compare."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.compare.data import MeshError
from bcid.explore.belief import Belief, Spread, entropy, patches
from bcid.explore.predictions import Anchored, Foreseen, Predictor
from bcid.measurement import Action, Measurement
from bcid.scene import Scene
from bcid.search.climb import neighbours
from bcid.search.misfit import Misfit
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
# Before anything was seen the error of the mesh is taken as this part of the motion.
_FIRST_ERROR = 0.03
# The best set misses what was seen by more than this many times what noise and mesh explain: no set does explain it.
MISSED = 1.5


@dataclass(frozen=True)
class Pulled:
    """A pull that was seen.

    Attributes:
        action: as the gripper really moved; frames numbered from 0.
        misfit: the comparison with what was seen.
    """

    action: Action
    misfit: Misfit

    @classmethod
    def of(cls, scene: Scene, measurement: Measurement) -> Pulled:
        """From a measurement that holds one action."""
        return cls(measurement.actions[0], Misfit(scene, measurement))

    @property
    def profile(self) -> Array:
        """Part of the motion that is done in each frame."""
        return profile(self.action)


def profile(action: Action) -> Array:
    """Distance of the gripper from rest in each frame, as part of the largest; shape (frames,)."""
    way = (
        np.linalg.norm(action.translation, axis=1) + np.linalg.norm(action.rotation - action.rotation[0], axis=1) * 1e-2
    )
    return np.asarray(way / max(float(way.max()), 1e-12))


@dataclass(frozen=True)
class View:
    """What is believed after some pulls.

    Attributes:
        probabilities: of every set looked at, the likeliest first.
        patches: probability that each patch is anchored.
        entropy: bits.
        rms: RMS residual of the likeliest set, m; NaN before anything was seen.
        missed: the same in units of what noise and mesh explain.
        error: RMS error of the mesh at the end of a pull, as part of its motion.
    """

    probabilities: dict[Anchored, float]
    patches: dict[str, float]
    entropy: float
    rms: float
    missed: float
    error: float

    @property
    def best(self) -> Anchored:
        """The likeliest set."""
        return next(iter(self.probabilities))

    @property
    def certainty(self) -> float:
        """Its probability."""
        return self.probabilities[self.best]


class Inference:
    """Bayes' rule over anchor sets. `view` is collective on the predictor's ranks, with the same result on all.

    Args:
        scene: the scene.
        predictor: of the working level.
        fine: of a finer level, from which the error of the working one is told; None if there is none.
        random_state: of the sets to begin with, where there are too many to look at all.
    """

    def __init__(self, scene: Scene, predictor: Predictor, fine: Predictor | None, random_state: int = 0) -> None:
        self.scene, self.predictor, self.fine = scene, predictor, fine
        names = list(scene.patches)
        if len(names) <= _ENUMERATED:
            sets = all_candidates(names)
        else:
            sets = random_seeds(names, _RANDOM, np.random.default_rng(random_state))
        self.sets: dict[Anchored, None] = dict.fromkeys(sets)
        self.pulls: list[Pulled] = []
        self._foreseen: dict[tuple[int, Anchored], Foreseen] = {}
        self._finely: dict[tuple[int, Anchored], Array] = {}
        # Chi-square and volume by pull, set, the set whose error of the mesh was taken, and whether buckling was looked for.
        self._seen: dict[tuple[int, Anchored, Anchored | None, bool], tuple[float, float]] = {}

    def add(self, measurement: Measurement) -> None:
        """Take what was seen of a pull."""
        self.pulls.append(Pulled.of(self.scene, measurement))

    def view(self) -> View:
        """What is believed now."""
        view = self._look()
        while self.pulls and (self._wake() or self._grow(view) or self._refine(view)):
            view = self._look()
        return view

    # -- which sets are looked at
    # --------------------------------------------------------------------------------------------------------------

    def _wake(self) -> bool:
        """Predict what is not known of sets that are not asleep; whether there was anything."""
        relative = self._belief()[0].relative()
        awake = [a for a in self.sets if relative.get(a, 0.0) > -_ASLEEP]
        todo = [(i, a) for i in range(len(self.pulls)) for a in awake if (i, a) not in self._foreseen]
        found = self.predictor.foresee((a, self.pulls[i].action) for i, a in todo)
        self._foreseen |= dict(zip(todo, found, strict=True))
        return bool(todo)

    def _grow(self, view: View) -> bool:
        """Take the neighbours of sets that contend among the hypotheses; whether there was any."""
        near = [n for a in self._contending(view) for n in neighbours(a, list(self.scene.patches))]
        fresh = [n for n in near if n not in self.sets]
        self.sets |= dict.fromkeys(fresh)
        return bool(fresh)

    def _refine(self, view: View) -> bool:
        """Predict the sets that contend on the fine level, and whether the body may buckle with them; whether there was any."""
        todo = [(i, a) for i in range(len(self.pulls)) for a in self._contending(view)]
        if view.missed > MISSED:
            # Where nothing explains what was seen, the body may have buckled with any of the sets.
            todo = [(i, a) for i in range(len(self.pulls)) for a in self.sets]
        soft = [(i, a) for i, a in todo if (i, a) in self._foreseen and not self._foreseen[i, a].detailed]
        found = self.predictor.foresee(((a, self.pulls[i].action) for i, a in soft), detailed=True)
        self._foreseen |= dict(zip(soft, found, strict=True))
        rough = [(i, a) for i in range(len(self.pulls)) for a in self._contending(view) if (i, a) not in self._finely]
        if self.fine is not None and rough:
            finely = self.fine.foresee((a, self.pulls[i].action) for i, a in rough)
            self._finely |= {key: f.positions for key, f in zip(rough, finely, strict=True)}
            return True
        return bool(soft)

    def _contending(self, view: View) -> list[Anchored]:
        likely = [a for a, p in view.probabilities.items() if p > _CONTENDS]
        return likely[:_CONTENDERS]

    # -- what they say
    # --------------------------------------------------------------------------------------------------------------

    def _look(self) -> View:
        belief, missed, rms, error = self._belief()
        known = belief.probabilities()
        if not known:
            known = dict.fromkeys(self.sets, 1.0 / len(self.sets))
        return View(known, patches(known, self.scene.patches), entropy(known.values()), rms, missed, error)

    def _belief(self) -> tuple[Belief, float, float, float]:
        """Belief, what the best set misses in units of its errors and in m, and the error of the mesh as part of the motion."""
        chi2, volumes = self._compared()
        every = sorted({i for i, _ in chi2})
        best = self._best(chi2, volumes, every)
        belief = Belief()
        if best is None:
            return belief, 0.0, math.nan, _FIRST_ERROR
        values = sum(self.pulls[i].misfit.values for i in every)
        missed = math.sqrt(sum(chi2[i, best] for i in every) / values)
        # What no set explains makes all of them less sure of themselves.
        scale = max(1.0, missed**2)
        for i in every:
            belief.add(i, {a: -0.5 * chi2[i, a] / scale - volumes[i, a] for at, a in chi2 if at == i})
        squares = [self._differences(i, best) for i in every]
        rms = math.sqrt(sum(float(np.nansum(d**2)) for d in squares) / values)
        return belief, missed, rms, self._relative_error(best)

    def _compared(self) -> tuple[dict[tuple[int, Anchored], float], dict[tuple[int, Anchored], float]]:
        """Chi-square and logarithm of the volume of the errors, by pull and set."""
        chi2: dict[tuple[int, Anchored], float] = {}
        volumes: dict[tuple[int, Anchored], float] = {}
        for (i, anchors), foreseen in self._foreseen.items():
            if foreseen.failed:
                chi2[i, anchors], volumes[i, anchors] = math.inf, 0.0
                continue
            key = i, anchors, self._nearest(i, anchors), foreseen.detailed
            if key not in self._seen:
                spread = self.spread(i, anchors)
                difference = self._differences(i, anchors)
                numbers = float(np.sum(spread.whiten(difference) ** 2)), spread.log_volume(np.isfinite(difference))
                self._seen[key] = numbers
            chi2[i, anchors], volumes[i, anchors] = self._seen[key]
        return chi2, volumes

    def _best(
        self, chi2: dict[tuple[int, Anchored], float], volumes: dict[tuple[int, Anchored], float], every: list[int]
    ) -> Anchored | None:
        """The likeliest of the sets that were compared with all these pulls."""
        full = [a for a in self.sets if every and all((i, a) in chi2 for i in every)]
        solved = [a for a in full if all(math.isfinite(chi2[i, a]) for i in every)]
        total = {a: sum(0.5 * chi2[i, a] + volumes[i, a] for i in every) for a in solved}
        return min(solved, key=lambda a: (total[a], len(a), sorted(a)), default=None)

    def _differences(self, pull: int, anchors: Anchored) -> Array:
        """Seen minus predicted, with the error of the mesh taken out, (frames, fiducials, 3), m; NaN where nothing was seen."""
        seen = self.pulls[pull]
        return np.asarray(
            seen.misfit.measured - self._foreseen[pull, anchors].positions - self._mesh(pull, anchors).correction
        )

    def spread(self, pull: int, anchors: Anchored) -> Spread:
        """Errors of a pull about a set's prediction."""
        seen = self.pulls[pull]
        motion = float(np.sqrt(np.nanmean((seen.misfit.measured - self.scene.rest) ** 2)))
        error = self._mesh(pull, anchors).rms if self.fine is not None else 0.0
        foreseen = self._foreseen[pull, anchors]
        if foreseen.detailed and foreseen.buckles:
            error = max(error, _ANYWHERE * motion)
        return Spread(seen.profile, seen.misfit.noise or 0.0, error)

    def _mesh(self, pull: int, anchors: Anchored) -> MeshError:
        """Error of the mesh in a pull: of the set itself, or of the nearest one of which it is known."""
        near = self._nearest(pull, anchors)
        if near is None:
            return MeshError.unknown(self.pulls[pull].misfit.measured.shape)
        gain = max(self._gain**2 - 1, 0.5)
        return MeshError.between(self._foreseen[pull, near].positions, self._finely[pull, near], gain)

    def _nearest(self, pull: int, anchors: Anchored) -> Anchored | None:
        """The set most like another of which the error of the mesh is known."""
        known = [a for i, a in self._finely if i == pull]
        return min(known, key=lambda a: (len(a ^ anchors), sorted(a)), default=None)

    @property
    def _gain(self) -> float:
        """How many times smaller the elements of the fine level are."""
        assert self.fine is not None
        coarse, fine = (p.forward().body.unknowns for p in (self.predictor, self.fine))
        return float((fine / coarse) ** (1 / 3))

    def _relative_error(self, best: Anchored) -> float:
        """RMS error that the mesh leaves, as part of the motion, over all pulls."""
        if self.fine is None:
            return 0.0
        motions = [float(np.sqrt(np.nanmean((p.misfit.measured - self.scene.rest) ** 2))) for p in self.pulls]
        errors = [self._mesh(i, best).rms for i in range(len(self.pulls))]
        known = [e / m for e, m in zip(errors, motions, strict=True) if e > 0 and m > 0]
        return float(np.mean(known)) if known else _FIRST_ERROR


def weights(probabilities: dict[Anchored, float], sets: Iterable[Anchored]) -> Array:
    """Probabilities of some sets, summing to one."""
    found = np.array([probabilities[a] for a in sets])
    return np.asarray(found / found.sum())
