"""Candidates for what is missing: effects fitted to a model, each with its set of anchors, and their evidence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, SolveError
from bcid.comparison.candidates import Start
from bcid.comparison.fit import Fit, fit, held_out
from bcid.comparison.hypothesis_search import HypothesisSearch, Look, Promise, weighed
from bcid.comparison.ranking import Row, rank
from bcid.comparison.state import State
from bcid.comparison.yielding import gives
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model, Term
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.criteria import SEEN
from bcid.inference.hypotheses import Hypothesis, log_prior
from bcid.inference.unknown_force import Evidence

Array = NDArray[np.float64]
Anchored = frozenset[str]
Found = TypeVar("Found")
# Many sets and effects are looked at in so many steps of each action besides rest.
STEPS = 2
# With these settings: a set with which steps must be halved more often is seldom the one.
GLANCE = Settings(rtol=1e-6, halvings=2)
# Candidates are refitted to this relative change of chi-square.
_ROUGH = 3e-3
# A reciprocal or a direction may need a start away from the neutral value: part of the way to the expected value.
_CAUTION = (1.0, 0.5, 0.2)
# What is exp(UNLIKELY) times less likely is left out, and not fitted where it promises to be exp(WORTH) times less likely than the
# best; or exp(_FAR) times where the best explains all, however rough that promise is.
UNLIKELY, WORTH, _FAR = 12.0, 3.0, 60.0
# The error of the mesh is that of numbers that are no more than this part of a notable change off; it is asked for so often anew.
_FAR_OFF, _REMESHED = 0.2, 2
# With the numbers of the best candidate sets are searched again, so often and with so many sets at most.
_MOVES, _WEIGHED = 4, 5


@dataclass(frozen=True)
class Rival:
    """A hypothesis that was fitted: a set of anchors, and the effects added to the model that was begun with.

    Attributes:
        names: of the effects, one after the other; none for the model as it was.
        fitted: the fit.
        evidence: of it, with and without an unknown force besides.
        known: how many effects may act.
        held_out: RMS residual when each action is predicted from the others, m, where that was asked.
    """

    names: tuple[str, ...]
    fitted: Fit
    evidence: Evidence
    known: int
    held_out: float | None = None

    @property
    def anchors(self) -> Anchored:
        """The set."""
        return self.fitted.state.anchors

    @property
    def term(self) -> Term:
        """The effect that was added last."""
        return self.fitted.state.model.terms[-1]

    @property
    def effect(self) -> str:
        """Its name."""
        return self.names[-1]

    @property
    def logs(self) -> dict[Hypothesis, float]:
        """Logarithms of evidence and prior, without and with an unknown force besides."""
        return {hypothesis: evidence + prior for hypothesis, (evidence, prior) in self.weights.items()}

    @property
    def weights(self) -> dict[Hypothesis, tuple[float, float]]:
        """The same one by one."""
        name, count = "+".join(self.names), len(self.names)
        return {
            Hypothesis(self.anchors, name): (self.evidence.plain, log_prior(count, False, self.known)),
            Hypothesis(self.anchors, name, True): (self.evidence.forced, log_prior(count, True, self.known)),
        }

    def shifted(self, log: float) -> Rival:
        """The same with so much more evidence."""
        return replace(
            self, evidence=replace(self.evidence, plain=self.evidence.plain + log, forced=self.evidence.forced + log)
        )

    def allowing(self, left: Array, begun: Model) -> Rival:
        """The same with what may be left of the error of the mesh as it is with another hypothesis, (frames, fiducials, 3), m."""
        old = self.fitted.state
        state = old.with_errors(replace(old.errors.mesh, left=left))
        raw = [old.errors.unwhiten(column) for column in self.fitted.jacobian.T]
        moved = [state.errors.whiten(column) for column in raw]
        jacobian = np.column_stack([*moved, np.zeros((len(old.predictor.data), 0))])
        return replace(self, evidence=weighed(state, begun, jacobian))

    @property
    def complete(self) -> bool:
        """Whether it is likelier that nothing else acts: no other hypothesis can do much better then."""
        plain, forced = self.logs.values()
        return plain > forced

    @property
    def log(self) -> float:
        """Of both together."""
        plain, forced = self.logs.values()
        return float(np.logaddexp(plain, forced))

    @classmethod
    def of(cls, fitted: Fit, begun: Model, known: int, least: float = SEEN) -> Rival:
        """Of a fit of a model that was begun from another; `least` as in `bcid.comparison.priors.visible`."""
        names = tuple(term.effect.name for term in fitted.state.model.added(begun))
        return cls(names, fitted, weighed(fitted.state, begun, fitted.jacobian, least), known)


def best_first(rivals: Iterable[Rival]) -> list[Rival]:
    """The likeliest first."""
    return sorted(rivals, key=lambda r: (-r.log, len(r.names), len(r.anchors), sorted(r.anchors), r.names))


def at_a_glance(state: State, work: Callable[[State], Found]) -> Found:
    """Work on a state at a few steps of each action; or on itself if it needs smaller ones."""
    try:
        thin = state.thinned(STEPS, GLANCE)
    except SolveError:
        return work(state)
    return work(thin)


@dataclass(frozen=True)
class Contest:
    """Hypotheses that were compared on a few steps.

    Attributes:
        rivals: those that were fitted, the likeliest first.
        promised: logarithms of evidence and of prior odds of those that do not seem worth a fit.
    """

    rivals: list[Rival]
    promised: dict[Hypothesis, tuple[float, float]]


def contest(
    state: State,
    begun: Model,
    known: Sequence[Effect],
    starts: Iterable[Anchored],
    sets: int,
    most: int,
    among: int | None = None,
    starts_of: Mapping[str, Start] | None = None,
) -> Contest:
    """Sets and effects on a few steps of each action, the likeliest fitted; collective.

    Args:
        state: the model with the set that is begun with, compared with all steps.
        begun: the model without effects that were added.
        known: the effects that may be missing.
        starts: further sets to begin with.
        sets: how many sets are weighed; with one set that of the state alone.
        most: how many effects are refitted.
        among: of how many effects these were chosen; they are all by default.
        starts_of: effects, see `bcid.comparison.candidates.Candidates`.
    """

    def work(thin: State) -> Contest:
        search = HypothesisSearch(thin, begun, known, sets, among=among)
        promises = search.run(starts) if sets > 1 else search.alone()
        return refitted(promises, begun, search.among, most, starts_of=starts_of)

    return at_a_glance(state, work)


def fitted_beside(state: State, known: Sequence[Effect], most: int) -> list[Rival]:
    """The most promising effects, so many at most, fitted beside a model with its set, to all steps; best first; collective."""

    def work(thin: State) -> Contest:
        return refitted(HypothesisSearch(thin, thin.model, known, 1).alone(), thin.model, len(known), most, math.inf)

    found = at_a_glance(state, work).rivals
    here = [rival for rival in found if rival.names and rival.anchors == state.anchors]
    fitted = [rival for rival in (promoted(one, state, state.model) for one in here) if rival]
    return best_first(replace(rival, held_out=held_out(rival.fitted)) for rival in fitted)


def refitted(
    promises: Sequence[Promise],
    begun: Model,
    count: int,
    most: int,
    worth: float = WORTH,
    starts_of: Mapping[str, Start] | None = None,
) -> Contest:
    """The models alone, and the most promising of `count` effects with their sets fitted; collective.

    An effect is worth a fit as long as something unknown acts besides the best, and where it promises to be no more than exp(worth)
    times less likely than that, or may turn out to be.
    What an effect promises is linear in its amount, which a large one is not: each has its best set tried first, and then the one
    that turns out best competes with itself on other sets. Anchors that give do so at a place, which goes with the set: these are
    tried with each set that was looked at for them. Some effects are tried first, with sets and numbers that are given.
    """
    promises = _in_turn(promises, starts_of or {})
    rivals = [_alone(p.look, begun, count) for p in promises if p.row is None]
    tried: set[tuple[str, Anchored | None]] = set()
    states: dict[Anchored, State] = {}
    for promise in promises:
        row, best = promise.row, best_first(rivals)[0]
        if row is None:
            continue
        what = row.effect, promise.anchors if gives(row.term.effect) else None
        if what in tried or len(tried) >= most or not math.isfinite(row.gain):
            continue
        # What has a start is fitted whatever explains all before it: it may do so with fewer numbers.
        started = row.effect in (starts_of or {})
        if not started and best.complete and promise.log < best.log - max(_unlikely(promise), worth):
            continue
        tried.add(what)
        promise.look.state.predictor.progress.step("candidates refitted", len(tried) - 1, most, f"now {row.effect}")
        # Where an effect makes another set likely it is measured by the errors of that.
        state = states.setdefault(promise.anchors, promise.look.state).with_own_errors()
        states[promise.anchors] = state
        rivals += refit(state, row, begun, count)
    best = best_first(rivals)[0]
    fitted = {effect for effect, _ in tried}
    if best.names and best.names[-1] in fitted:
        rivals += moved(best, begun, count)
    promised = {}
    for promise in promises:
        if promise.row and promise.row.effect not in fitted and math.isfinite(promise.log):
            names = [*(term.effect.name for term in promise.look.state.model.added(begun)), promise.row.effect]
            promised[Hypothesis(promise.anchors, "+".join(names))] = promise.evidence, promise.log_prior
    return Contest(best_first(rivals), promised)


def _in_turn(promises: Sequence[Promise], starts: Mapping[str, Start]) -> list[Promise]:
    """Promises of effects that have a start first, with its numbers, in the order of the starts; none of them with another set."""
    first = []
    for name, start in starts.items():
        here = [p for p in promises if p.row and p.row.effect == name and p.anchors == start.anchors]
        first += [replace(p, row=replace(p.row, term=p.row.term.with_values(start.values))) for p in here if p.row]
    own = {p.row.effect for p in first if p.row}
    return [
        *(p for p in promises if p.row is None),
        *first,
        *(p for p in promises if p.row and p.row.effect not in own),
    ]


def _unlikely(promise: Promise) -> float:
    """By how much less likely a promised effect must be than one that explains all not to be worth a fit.

    What its sensitivities promise holds to first order: they may be wrong by as large a part of what there is to explain as what
    the effect does is of what the pulls do.
    """
    state, row = promise.look.state, promise.row
    assert row is not None
    data = state.predictor.data
    pulled = data.vector(state.predicted) - data.vector(np.broadcast_to(data.rest, data.mask.shape))
    bent = float(np.linalg.norm(state.errors.unwhiten(row.explained)) / max(float(np.linalg.norm(pulled)), 1e-12))
    return min(WORTH + bent * (max(state.chi2 - len(data), 0.0) + row.score) / 2, _FAR)


def _alone(look: Look, begun: Model, known: int) -> Rival:
    """A model as it is, with a set."""
    state = look.state
    names = tuple(term.effect.name for term in state.model.added(begun))
    return Rival(names, Fit.at(state), look.evidence, known)


def moved(rival: Rival, begun: Model, known: int, least: float = SEEN) -> list[Rival]:
    """The best rival on other sets with its numbers in place, and fitted anew on those that its tangent shows to be as likely."""
    found: list[Rival] = []
    best, tried, about = rival, {rival.anchors}, None
    for _ in range(_MOVES):
        state = best.fitted.state
        if about is None or about.base is not state:
            about = HypothesisSearch(state, begun, (), _WEIGHED, least, known)
            found += [_alone(p.look, begun, known) for p in about.around() if p.anchors != best.anchors]
        shown = about.shown(best.anchors)
        near = [s for s in shown if s not in tried and shown[s] > shown[best.anchors] - WORTH]
        if not near:
            break
        anchors = min(near, key=lambda s: (-shown[s], len(s), sorted(s)))
        tried.add(anchors)
        with suppress(SolveError):
            again = Rival.of(fit(state.of_set(anchors), state.free, most=8, ftol=_ROUGH), begun, known, least)
            found.append(again)
            best = again if again.log > best.log else best
    fitted = {id(r) for r in found if r.fitted.coordinates}
    # Where a set was fitted that does not stand beside what was only estimated for it.
    sets = {r.anchors for r in found if id(r) in fitted} | {rival.anchors}
    return [r for r in found if id(r) in fitted or r.anchors not in sets]


def shown_about(rival: Rival, begun: Model, least: float = SEEN) -> dict[Anchored, float]:
    """Logarithm of the evidence of sets near that of a rival, as its tangent shows them; collective."""
    search = HypothesisSearch(rival.fitted.state, begun, (), 1, least)
    search.look()
    return search.shown(rival.anchors)


def promoted(
    rival: Rival, full: State, begun: Model, least: float = SEEN, anchors: Anchored | None = None
) -> Rival | None:
    """A rival that was fitted to a part of the steps, with all of them and the error of the mesh of its own; None if it fails.

    An effect may stand for what the mesh has wrong with another model: its own tells. With `anchors`, on another set.
    """
    model, free = rival.fitted.state.model, rival.fitted.state.free
    anchors = rival.anchors if anchors is None else anchors
    alike = (full.model.name, full.anchors) == (model.name, anchors)
    mesh = full.errors.mesh if alike else None
    onset = rival.names and any(p.onset for p in rival.term.effect.parameters)
    try:
        if onset:
            # In which frame it begins is only known once all are looked at.
            base = State.of(
                full.predictor,
                model.without(rival.term.label),
                anchors,
                full.errors.mesh if anchors == full.anchors else None,
            )
            rows = rank(base, [rival.term.effect], strict=False).rows
            again = refit(base, rows[0], begun, rival.known, least)
            return again[0] if again else None
        if anchors != rival.anchors:
            # Its numbers will be others, and the error of the mesh with them.
            mesh = rival.fitted.state.errors.mesh
        found = fit(State.of(full.predictor, model, anchors, mesh), free, most=8)
        if anchors != rival.anchors:
            there = Rival.of(found, begun, rival.known, least)
            if there.log < rival.log - _FAR:
                # It has lost whatever the error of the mesh is with it.
                return there
        for _ in range(_REMESHED):
            if anchors == rival.anchors and not _elsewhere(found, model):
                break
            model, rival = found.state.model, replace(rival, fitted=found)
            found = fit(found.state.with_own_errors(anew=True), free, most=4)
    except (SolveError, InputError):
        return None
    return Rival.of(found, begun, rival.known, least)


def _elsewhere(found: Fit, model: Model) -> bool:
    """Whether fitted numbers are so far from those of a model that the error of the mesh may be another."""
    before, after = model.constants(), found.state.model.constants()
    return any(abs(c.of(after[c.name]) - c.of(before[c.name])) > _FAR_OFF * c.scale for c in found.coordinates)


def refit(state: State, row: Row, begun: Model, known: int, least: float = SEEN) -> list[Rival]:
    """Add an effect, begin at what is expected of it, and fit everything together; nothing if that cannot be followed."""
    for part in _CAUTION:
        try:
            term = _careful(row, state.model, part)
            start = state.of_set(state.anchors, state.model + term)
            again = fit(start, (*state.free, *term.free), most=8, ftol=_ROUGH)
        except (SolveError, InputError):
            continue
        return [Rival.of(again, begun, known, least)]
    return []


def _careful(row: Row, model: Model, part: float) -> Term:
    """The expected term, or a part of it, within its bounds."""
    values = {}
    for p in row.term.effect.parameters:
        value, neutral = row.term.values[p.name], model.neutral(p)
        if p.reciprocal:
            value = p.scale if not math.isfinite(value) else value / part
            value = min(value, 1e4 * p.scale)
        elif p.switch and neutral is not None:
            value = neutral + p.scale
        elif neutral is not None:
            value = neutral + part * (value - neutral)
        values[p.name] = float(np.clip(value, p.lower, p.upper))
    return Term(row.term.effect, values, place=row.term.place)
