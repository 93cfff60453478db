"""Effects as candidates for what is missing: refitted, each with its set of anchors, and put in order."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from bcid.base.errors import InputError, SolveError
from bcid.comparison.anchors import search
from bcid.comparison.fit import Fit, fit, held_out
from bcid.comparison.joint import NEARLY, Proposal
from bcid.comparison.ranking import Row, rank
from bcid.comparison.state import State
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model, Term
from bcid.forms.solver.equilibrium import Settings

Anchored = frozenset[str]
Found = TypeVar("Found")
# Many sets and effects are looked at in so many steps of each action besides rest.
STEPS = 2
# When another is nearly adequate, a candidate is not refitted that is expected to leave more than this chi-square per value.
_FAR = 4.0
# A model explains what is missing when it explains this part of what noise and mesh leave open, adequate or not: then
# something small is missing besides.
_NEARLY_ALL = 0.95
# So many of the candidates are compared with all steps; the best, and what leaves no more than so many times as much, is
# fitted to them.
_PROMOTED, _CLOSE = 2, 1.15
# The best candidate's set of anchors and its numbers are improved in turn, so often at most, unless it leaves less than so
# many times the noise (chi-square per value).
_MOVES, _DONE = 3, 1.1
# Candidates are refitted to this relative change of chi-square.
_ROUGH = 3e-3
# A reciprocal or a direction may need a start away from the neutral value: part of the way to the expected value.
_CAUTION = (1.0, 0.5, 0.2)


@dataclass(frozen=True)
class Rival:
    """A candidate that was refitted: a set of anchors and an effect added to the model before.

    Attributes:
        effect: name of the effect.
        term: fitted.
        anchors: the set.
        fitted: the fit.
        bic: of the fit, see `Fit.bic`.
        held_out: RMS residual when each action is predicted from the others, m, for the best rivals.
    """

    effect: str
    term: Term
    anchors: Anchored
    fitted: Fit
    bic: float
    held_out: float | None = None

    def with_fit(self, fitted: Fit) -> Rival:
        """The same candidate fitted again."""
        return replace(self, term=fitted.state.model.terms[-1], fitted=fitted, bic=fitted.bic)


def contest(state: State, proposals: Iterable[Proposal], most: int) -> list[Rival]:
    """Refit the most promising effects to a few steps of each action, and the best of these to all; best first; collective.

    Args:
        state: the model that the effects are added to, compared with all steps.
        proposals: effects and sets of anchors.
        most: how many are refitted.
    """
    waiting = list(proposals)
    glanced = at_a_glance(state, 2, lambda thin: refit_candidates(thin, waiting, most))
    promising = [promoted(rival, state, glanced[0]) for rival in glanced[:_PROMOTED]]
    return sorted((rival for rival in promising if rival), key=lambda rival: rival.bic)


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


def explained(before: Fit, after: Fit) -> float:
    """Which part of a model's chi-square beyond that of noise and mesh another one explains."""
    values = len(before.state.predictor.data)
    return (before.state.chi2 - after.state.chi2) / max(before.state.chi2 - values, 1e-9)


def explains(before: Fit, after: Fit, adequate: bool) -> bool:
    """Whether what was added to a model may be named: the model is adequate with it, or it explains nearly all."""
    return adequate or explained(before, after) > _NEARLY_ALL


def refit_candidates(state: State, proposals: Iterable[Proposal], most: int) -> list[Rival]:
    """Add the most promising effects to a model, each with its set of anchors, and refit all; best first; collective.

    At most `most` are refitted; the best of them also goes to other sets, when its numbers make them fit better.
    """
    rivals: list[Rival] = []
    waiting = [(p.effect, p) for p in sorted(proposals, key=lambda p: p.left / p.values) if p.effect is not None]
    # What an effect promises is linear in its amount, which a large one is not: each has its best set tried first, and then
    # the one that turns out best competes with itself on another set.
    tried: set[str] = set()
    for effect, proposal in waiting:
        if effect.name in tried or len(rivals) >= most - 1 or _hopeless(proposal, rivals):
            continue
        tried.add(effect.name)
        state.predictor.progress.step("candidates refitted", len(tried) - 1, most, f"now {effect.name}")
        rivals += refit(state, effect, proposal.anchors)
    if not rivals:
        return []
    best = min(rivals, key=lambda rival: rival.bic)
    others = (p.anchors for effect, p in waiting if effect == best.term.effect and p.anchors != best.anchors)
    for anchors in itertools.islice(others, 1):
        rivals += refit(state, best.term.effect, anchors)
    best = min(rivals, key=lambda rival: rival.bic)
    return sorted([*_moved(best), *rivals], key=lambda rival: rival.bic)


def _moved(rival: Rival) -> list[Rival]:
    """A rival on the sets that are climbed to with its fitted numbers in place, as long as they leave less.

    Where it leaves next to nothing the set is looked at later, on all steps.
    """
    found: list[Rival] = []
    for _ in range(_MOVES):
        state = rival.fitted.state
        if state.chi2 < _DONE * len(state.predictor.data):
            break
        try:
            anchors = frozenset(search(state.predictor, state.model, state.errors.mesh, [state.anchors], "no").anchored)
            if anchors == state.anchors:
                break
            start = State.of(state.predictor, state.model, anchors, state.errors.mesh)
            again = fit(start, state.free, most=8, ftol=_ROUGH)
        except SolveError:
            break
        if again.bic >= rival.bic:
            break
        rival = replace(rival.with_fit(again), anchors=anchors)
        found.append(rival)
    return found


def promoted(rival: Rival, state: State, best: Rival) -> Rival | None:
    """A rival that was fitted to a part of the steps, with all that the state looks at; None if that cannot be followed.

    Unless it is far from the best one it is fitted again, with an error of the mesh of its own.
    """
    model = rival.fitted.state.model
    far = rival.bic > _CLOSE * best.bic
    if any(p.onset for p in rival.term.effect.parameters):
        # In which frame it begins is only known once all are looked at.
        fits = [found.fitted for found in refit(state, rival.term.effect, rival.anchors)]
    else:
        try:
            start = State.of(state.predictor, model, rival.anchors, state.errors.mesh if far else None)
            fits = [fit(start, rival.fitted.state.free, most=1 if far else 8)]
        except (SolveError, InputError):
            fits = []
    return replace(rival.with_fit(fits[0]), held_out=held_out(fits[0])) if fits else None


def _hopeless(proposal: Proposal, rivals: Sequence[Rival]) -> bool:
    """Whether a rival explains nearly all already, and this effect does not promise to come near that."""
    best = min((r.fitted.state.chi2 / len(r.fitted.state.predictor.data) for r in rivals), default=math.inf)
    return best < NEARLY and proposal.left > _FAR * proposal.values


def refit(state: State, effect: Effect, anchors: Anchored) -> list[Rival]:
    """Add an effect, begin at what is expected of it, and fit everything together; nothing if that cannot be followed."""
    try:
        base = State.of(state.predictor, state.model, anchors, state.errors.mesh, state.free)
    except SolveError:
        return []
    row = rank(base, [effect], strict=False).rows[0]
    for part in _CAUTION:
        try:
            term = _careful(row, base.model, part)
            start = State.of(base.predictor, base.model + term, base.anchors, base.errors.mesh)
            again = fit(start, (*state.free, *term.free), most=8, ftol=_ROUGH)
        except (SolveError, InputError):
            continue
        return [Rival(row.effect, again.state.model.terms[-1], base.anchors, again, again.bic)]
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
