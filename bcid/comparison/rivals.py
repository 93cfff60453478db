"""Candidates for what is missing: effects fitted to a model, each with its set of anchors, and their evidence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, SolveError
from bcid.comparison.fit import Fit, fit, held_out
from bcid.comparison.hypothesis_search import HypothesisSearch, Look, Promise, weighed
from bcid.comparison.ranking import Row, rank
from bcid.comparison.state import State
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
# Candidates are refitted to this relative change of chi-square.
_ROUGH = 3e-3
# A reciprocal or a direction may need a start away from the neutral value: part of the way to the expected value.
_CAUTION = (1.0, 0.5, 0.2)
# Where one explains all, an effect is not fitted that promises to be exp(_FAR) times less likely.
_FAR = 60.0
# With the numbers of the best candidate sets are searched again, so often and with so many sets at most.
_MOVES, _WEIGHED = 3, 5


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
        return self.tempered(1.0)

    def tempered(self, power: float) -> dict[Hypothesis, float]:
        """The same with a power of the evidence."""
        name, count = "+".join(self.names), len(self.names)
        return {
            Hypothesis(self.anchors, name): power * self.evidence.plain + log_prior(count, False, self.known),
            Hypothesis(self.anchors, name, True): power * self.evidence.forced + log_prior(count, True, self.known),
        }

    def shifted(self, log: float) -> Rival:
        """The same with so much more evidence."""
        return replace(
            self, evidence=replace(self.evidence, plain=self.evidence.plain + log, forced=self.evidence.forced + log)
        )

    def allowing(self, left: Array, begun: Model) -> Rival:
        """The same with what may be left of the error of the mesh as it is with another hypothesis, (frames, fiducials, 3), m."""
        old = self.fitted.state
        state = old.with_mesh(replace(old.errors.mesh, left=left))
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


def at_a_glance(state: State, halvings: int, work: Callable[[State], Found]) -> Found:
    """Work on a state at a few steps of each action, each halved so often at most; or on itself if it needs smaller ones."""
    try:
        thin = state.thinned(STEPS, Settings(rtol=1e-6, halvings=halvings))
    except SolveError:
        return work(state)
    try:
        return work(thin)
    finally:
        thin.predictor.destroy()


def contest(
    state: State, begun: Model, known: Sequence[Effect], starts: Iterable[Anchored], sets: int, most: int
) -> list[Rival]:
    """Sets and effects on a few steps of each action, the likeliest fitted; best first; collective.

    Args:
        state: the model with the set that is begun with, compared with all steps.
        begun: the model without effects that were added.
        known: the effects that may be missing.
        starts: further sets to begin with.
        sets: how many sets are weighed; with one set that of the state alone.
        most: how many effects are refitted.
    """

    def work(thin: State) -> list[Rival]:
        search = HypothesisSearch(thin, begun, known, sets)
        promises = search.run(starts) if sets > 1 else search.alone()
        return refitted(promises, begun, known, most)

    return at_a_glance(state, 2, work)


def fitted_beside(state: State, known: Sequence[Effect], most: int) -> list[Rival]:
    """The most promising effects, so many at most, fitted beside a model with its set, to all steps; best first; collective."""
    found = contest(state, state.model, known, (), 1, most)
    here = [rival for rival in found if rival.names and rival.anchors == state.anchors]
    return best_first(rival for rival in (promoted(one, state, state.model) for one in here) if rival)


def refitted(promises: Sequence[Promise], begun: Model, known: Sequence[Effect], most: int) -> list[Rival]:
    """The models alone, and the most promising effects with their sets fitted; best first; collective.

    What an effect promises is linear in its amount, which a large one is not: each has its best set tried first, and then the one
    that turns out best competes with itself on other sets.
    """
    count = len(known)
    rivals = [_alone(p.look, begun, count) for p in promises if p.row is None]
    tried: set[str] = set()
    for promise in promises:
        row, best = promise.row, best_first(rivals)[0]
        if row is None or row.effect in tried or len(tried) >= most or not math.isfinite(row.gain):
            continue
        if tried and best.complete and promise.log < best.log - _FAR:
            break
        tried.add(row.effect)
        promise.look.state.predictor.progress.step("candidates refitted", len(tried) - 1, most, f"now {row.effect}")
        rivals += refit(promise.look.state, row, begun, count)
    best = best_first(rivals)[0]
    if best.names:
        rivals += moved(best, begun, count)
    return best_first(rivals)


def _alone(look: Look, begun: Model, known: int) -> Rival:
    """A model as it is, with a set."""
    state = look.state
    names = tuple(term.effect.name for term in state.model.added(begun))
    return Rival(names, Fit.at(state), look.evidence, known)


def moved(rival: Rival, begun: Model, known: int, least: float = SEEN) -> list[Rival]:
    """The best rival on sets around its own with its numbers in place, and fitted anew where that is likelier."""
    found: list[Rival] = []
    best = rival
    for _ in range(_MOVES):
        state = best.fitted.state
        search = HypothesisSearch(state, begun, (), _WEIGHED, least)
        others = [p for p in search.around() if p.anchors != best.anchors]
        found += [_alone(p.look, begun, known) for p in others]
        if not others or others[0].log <= best.log:
            break
        try:
            again = Rival.of(fit(others[0].look.state, state.free, most=8, ftol=_ROUGH), begun, known, least)
        except SolveError:
            break
        found.append(again)
        if again.log <= best.log:
            break
        best = again
    return found


def promoted(rival: Rival, full: State, begun: Model, least: float = SEEN) -> Rival | None:
    """A rival that was fitted to a part of the steps, with all of them and the error of the mesh of its own; None if it fails.

    An effect may stand for what the mesh has wrong with another model: its own tells.
    """
    model, free = rival.fitted.state.model, rival.fitted.state.free
    alike = (full.model.name, full.anchors) == (model.name, rival.anchors)
    mesh = full.errors.mesh if alike else None
    onset = rival.names and any(p.onset for p in rival.term.effect.parameters)
    try:
        if onset:
            # In which frame it begins is only known once all are looked at.
            base = State.of(
                full.predictor,
                model.without(rival.term.label),
                rival.anchors,
                full.errors.mesh if rival.anchors == full.anchors else None,
            )
            rows = rank(base, [rival.term.effect], strict=False).rows
            again = refit(base, rows[0], begun, rival.known, least)
            return replace(again[0], held_out=held_out(again[0].fitted)) if again else None
        start = State.of(full.predictor, model, rival.anchors, mesh)
        found = fit(start, free, most=8)
    except (SolveError, InputError):
        return None
    return replace(Rival.of(found, begun, rival.known, least), held_out=held_out(found))


def refit(state: State, row: Row, begun: Model, known: int, least: float = SEEN) -> list[Rival]:
    """Add an effect, begin at what is expected of it, and fit everything together; nothing if that cannot be followed."""
    for part in _CAUTION:
        try:
            term = _careful(row, state.model, part)
            start = State.of(state.predictor, state.model + term, state.anchors, state.errors.mesh)
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
        elif neutral is not None:
            value = neutral + part * (value - neutral)
        values[p.name] = float(np.clip(value, p.lower, p.upper))
    return Term(row.term.effect, values, place=row.term.place)
