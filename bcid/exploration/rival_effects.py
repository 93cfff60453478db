"""Rival effects: each is fitted to all pulls, with the anchor sets that go with it, and its evidence is compared with theirs.

The evidence of a hypothesis with unknown numbers is the likelihood averaged over what was believed of them before, here in
Laplace's approximation (MacKay 2003, chapter 28): with chi-square X at the best fit, J the derivative of the residual in
units of its errors, S the standard deviations believed before, G = S J'J S, and z the way from what was expected in units of S,

    log Z = -X/2 - z' G (1 + G)^-1 z / 2 - log det(1 + G) / 2 - log det(errors) / 2 .

So an effect that could have been seen and was not loses, and one that these pulls would not show keeps its chance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.base.errors import SolveError
from bcid.comparison.fit import Coordinate, Fit, fit
from bcid.comparison.joint import NEARLY, Proposal, propose
from bcid.comparison.predictor import Predictor
from bcid.comparison.rivals import Rival, at_a_glance, refit
from bcid.comparison.state import State
from bcid.exploration.joined import joined
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.inference.hypotheses import Anchored, Hypothesis
from bcid.measurement import Measurement
from bcid.scene import Scene

Array = NDArray[np.float64]
# Sets looked at together with the effects, and in a climb with the numbers of one, at most; how often that is repeated.
_SETS, _AROUND, _AGAIN = 56, 80, 3
# An effect is fitted with so many sets that promise much, and kept with so many.
_TRIED, _KEPT = 3, 3
# A set is kept with odds of at least exp(-_NEAR) against the best one of the effect, as a few steps of each pull tell.
_NEAR = 10.0
# An effect that a few steps of each pull put so far behind the best one (half of chi-square) is not fitted with other sets.
_FAR = 100.0
# Before any pull an amount is expected within so many notable ones of nothing.
_AMOUNT = 2.0


@dataclass(frozen=True)
class Fitted:
    """A hypothesis with its numbers fitted to all pulls.

    Attributes:
        hypothesis: set and effect.
        fitted: the fit.
        begun: the model without the effect.
    """

    hypothesis: Hypothesis
    fitted: Fit
    begun: Model

    @cached_property
    def model(self) -> Model:
        """The model with the likeliest numbers: what the pulls do not tell is as it was expected."""
        apart, size = self._before
        numbers = self.fitted.state.model.constants()
        back = size * np.linalg.solve(self._precision, apart / size) if len(size) else apart
        at = {c.name: c.of(numbers[c.name]) - b for c, b in zip(self.fitted.coordinates, back, strict=True)}
        return self.fitted.state.model.with_values({c.name: c.allowed(at[c.name]) for c in self.fitted.coordinates})

    @property
    def rms(self) -> float:
        """RMS residual, m."""
        return self.fitted.state.rms

    @cached_property
    def chi2(self) -> float:
        """Chi-square."""
        return self.fitted.state.chi2

    @property
    def missed(self) -> float:
        """RMS residual in units of its errors."""
        return math.sqrt(self.chi2 / len(self.fitted.state.predictor.data))

    @cached_property
    def log(self) -> float:
        """Logarithm of the evidence, where nothing is missing besides."""
        apart, size = self._before
        precision = self._precision
        z = apart / size
        # G (1 + G)^-1 = 1 - (1 + G)^-1.
        surprise = float(z @ (z - np.linalg.solve(precision, z)))
        occam = float(np.linalg.slogdet(precision)[1])
        return -0.5 * (self.chi2 + surprise + occam) - self._volume

    @cached_property
    def deviating(self) -> list[Model]:
        """The model with its numbers one standard deviation off, one model for each independent combination of them."""
        numbers = self.model.constants()
        coordinates = self.fitted.coordinates
        if not coordinates:
            return []
        _, size = self._before
        covariance = size[:, None] * np.linalg.inv(self._precision) * size
        found = []
        for column in np.linalg.cholesky(covariance).T:
            # Where the limit of a number is near it deviates to the other side.
            values = {}
            for c, step in zip(coordinates, column, strict=True):
                at, (lower, upper) = c.of(numbers[c.name]), c.bounds
                values[c.name] = c.allowed(at + step if lower <= at + step <= upper else at - step)
            found.append(self.model.with_values(values))
        return found

    @property
    def amounts(self) -> dict[str, tuple[float, float]]:
        """Fitted numbers of the effect by full name, with standard errors."""
        return {name: (value, self.fitted.stderr[name]) for name, value in self.fitted.values.items()}

    def unit(self, name: str) -> str:
        """Unit of one of them."""
        return next(c.parameter.unit for c in self.fitted.coordinates if c.name == name)

    @cached_property
    def _volume(self) -> float:
        return self.fitted.state.errors.log_volume

    @cached_property
    def _before(self) -> tuple[Array, Array]:
        """How far the fitted coordinates are from what was expected, and its standard deviation."""
        numbers = self.fitted.state.model.constants()
        known = [_believed(c, self.begun, c.of(numbers[c.name])) for c in self.fitted.coordinates]
        return np.array([a for a, _ in known]), np.array([s for _, s in known])

    @cached_property
    def _precision(self) -> Array:
        """1 + G."""
        _, size = self._before
        jacobian = self.fitted.jacobian * size
        return np.asarray(np.eye(len(size)) + jacobian.T @ jacobian)


def _believed(c: Coordinate, begun: Model, at: float) -> tuple[float, float]:
    """Of a coordinate, how far it is from what was expected before any pull, and the standard deviation of that."""
    p = c.parameter
    if p.prior is not None:
        return at - p.prior[0], p.prior[1]
    if p.period is not None:
        return 0.0, p.period / math.sqrt(12)
    neutral = 0.0 if p.reciprocal else begun.neutral(p)
    return (0.0 if neutral is None else at - neutral), _AMOUNT * c.scale


class RivalEffects:
    """Fits effects to pulls. `look` is collective on `comm`, with the same result on all ranks.

    Args:
        scene: the scene.
        comm: an MPI communicator.
        level: fine level (see `Predictor`).
        effects: the effects that may act.

    Attributes:
        names: of the effects.
    """

    def __init__(self, scene: Scene, comm: Comm, level: int | None, effects: Sequence[Effect]) -> None:
        self.scene, self.comm, self.level, self.effects = scene, comm, level, list(effects)
        self.names = tuple(effect.name for effect in effects)
        self._predictor: Predictor | None = None
        # By effect, its best set after the pulls before.
        self._sets: dict[str, Anchored] = {}

    def look(self, pulls: Sequence[Measurement], likely: Iterable[Anchored]) -> list[Fitted]:
        """Hypotheses with numbers that fit all pulls: the likely sets alone, and each effect with a few sets.

        Nothing when the body cannot be followed with any of the likely sets.
        """
        measurement = joined(pulls, self.scene)
        self._predictor = self._predictor or Predictor(self.scene, measurement, self.comm, self.level)
        predictor = self._predictor.repeating(measurement)
        begun = Model.of(self.scene)
        alone = [
            s for s in (_followed(predictor, begun, a) for a in dict.fromkeys([*likely, *self._sets.values()])) if s
        ]
        if not alone:
            return []
        plain = [Fitted(Hypothesis(s.anchors), fit(s, ()), begun) for s in alone]
        base = min(alone, key=lambda state: state.deviance)
        others = [state.anchors for state in alone if state is not base]
        acting = [e for e in self.effects if not (e.needs and e.needs(self.scene, measurement))]
        proposals = at_a_glance(base, 0, lambda thin: propose(thin, others, _SETS, acting))
        glanced = at_a_glance(base, 2, lambda thin: self._glanced(thin, acting, proposals))
        found: dict[Hypothesis, Fitted] = {}
        for name, candidates in glanced.items():
            fits = [Fitted(Hypothesis(f.state.anchors, name), f, begun) for f in _settled(base, candidates)]
            for one in sorted(fits, key=lambda one: one.log):
                found[one.hypothesis] = one
                self._sets[name] = one.hypothesis.anchors
        predictor.drop([begun, *(f.model for f in found.values())])
        return [*plain, *found.values()]

    def _glanced(
        self, thin: State, effects: Sequence[Effect], proposals: Sequence[Proposal]
    ) -> dict[str, list[tuple[Rival, list[Anchored]]]]:
        """Effects fitted to a few steps of each pull, the best fit first, with the sets that may go with its numbers."""
        found, least = {}, math.inf
        for effect in effects:
            promising = [p.anchors for p in proposals if p.effect is not None and p.effect.name == effect.name]
            known = [self._sets[effect.name]] if effect.name in self._sets else []
            sets = list(dict.fromkeys([*known, thin.anchors, *promising]))[:_TRIED]
            rivals = sorted((r for a in sets for r in refit(thin, effect, a)), key=lambda rival: rival.bic)
            least = min([least, *(r.bic for r in rivals)])
            best = [_climbed(r) if r.bic < least + 2 * _FAR else (r, [r.anchors]) for r in rivals[:1]]
            found[effect.name] = [*best, *((r, [r.anchors]) for r in rivals)]
        return found

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._predictor is not None:
            self._predictor.destroy()


def _followed(predictor: Predictor, model: Model, anchors: Anchored) -> State | None:
    try:
        return State.of(predictor, model, anchors)
    except SolveError:
        return None


def _climbed(rival: Rival) -> tuple[Rival, list[Anchored]]:
    """A rival on the set that it climbs to, its numbers fitted to each, and the sets there that do as well."""
    near = _near(rival)
    for _ in range(_AGAIN):
        if near[0] == rival.anchors:
            break
        state = rival.fitted.state
        try:
            # The error of the mesh was that of another set, which may have been far from this one.
            moved = fit(State.of(state.predictor, state.model, near[0]), state.free, most=8)
        except SolveError:
            break
        if moved.bic >= rival.bic:
            break
        rival = replace(rival.with_fit(moved), anchors=near[0])
        near = _near(rival)
    return rival, near


def _near(rival: Rival) -> list[Anchored]:
    """The sets that do as well as a rival's own with its numbers, which are refitted to each by their tangent.

    Where the rival is not nearly adequate a climb patch by patch may have ended too early: patches are exchanged too.
    """
    state, every = rival.fitted.state, frozenset(rival.fitted.state.predictor.scene.patches)
    poor = state.chi2 > NEARLY * len(state.predictor.data)
    exchanged = [
        rival.anchors - {a} | {b} for a in sorted(rival.anchors) for b in sorted(every - rival.anchors) if poor
    ]
    around = propose(state, exchanged, _AROUND, [])
    least = min((p.left for p in around), default=math.inf)
    near = [p.anchors for p in around if p.left < least + 2 * _NEAR and _at_its_place(rival, p.anchors)]
    return list(dict.fromkeys([*near[:_KEPT], rival.anchors]))


def _at_its_place(rival: Rival, anchors: Anchored) -> bool:
    """Whether the effect can act where it does, with other anchors."""
    places = rival.term.effect.places
    return places is None or rival.term.place in places(rival.fitted.state.predictor.scene, anchors)


def _settled(base: State, candidates: Iterable[tuple[Rival, list[Anchored]]]) -> list[Fit]:
    """The best of an effect's fits with all steps, for the sets that may go with it."""
    for rival, sets in candidates:
        fits = [f for f in (_fitted(base, rival.fitted.state, anchors) for anchors in sets) if f]
        if fits:
            return fits
    return []


def _fitted(base: State, rough: State, anchors: Anchored) -> Fit | None:
    """A rough fit once more, with all steps and the error of the mesh that goes with it; None if it cannot be followed."""
    try:
        return fit(State.of(base.predictor, rough.model, anchors), rough.free, most=8)
    except SolveError:
        return None
