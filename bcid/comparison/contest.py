"""Sets of anchors and effects compared on a few steps of each action, and the likeliest fitted there."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from bcid.base.errors import InputError, SolveError
from bcid.comparison.candidates import Candidates, StandIn, Start
from bcid.comparison.held_out import held_out
from bcid.comparison.hypothesis_search import HypothesisSearch, Kept, Look, Promise, Promised
from bcid.comparison.loosened import loosens
from bcid.comparison.rivals import (
    Rival,
    best_first,
    moved,
    promoted,
    refit,
    small_part,
    stood_in,
    with_own_mesh,
)
from bcid.comparison.state import State
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.criteria import NOTABLE
from bcid.inference.hypotheses import Hypothesis
from bcid.predict.predictor import Predictor
from bcid.search.settings import SETTINGS

Anchored = frozenset[str]
Found = TypeVar("Found")
# With these settings: a set with which steps must be halved more often is seldom the one.
GLANCE = Settings(rtol=1e-6, halvings=2)


def glanced(predictor: Predictor) -> int:
    """So many steps of each action."""
    data = predictor.data
    seen = len(data) / max(len(np.unique(data.frame)), 1)
    return max(SETTINGS.steps, math.ceil(SETTINGS.values / max(seen * len(predictor.actions), 1)))


def at_a_glance(state: State, work: Callable[[State], Found]) -> Found:
    """Work on a state at a few steps of each action; or on itself if it needs smaller ones."""
    try:
        thin = state.thinned(glanced(state.predictor), GLANCE)
    except SolveError:
        return work(state)
    return work(thin)


@dataclass(frozen=True)
class Contest:
    """Hypotheses that were compared on a few steps.

    Attributes:
        rivals: those that were fitted, the likeliest first.
        promised: those that do not seem worth a fit.
        kept: what tangents said of hypotheses that were looked at or fitted later.
    """

    rivals: list[Rival]
    promised: dict[Hypothesis, Promised]
    kept: tuple[Kept, ...] = ()


def contest(
    state: State,
    begun: Model,
    known: Sequence[Effect],
    starts: Iterable[Anchored],
    sets: int,
    most: int,
    among: int | None = None,
    candidates: Candidates | None = None,
) -> Contest:
    """Sets and effects on a few steps of each action, the likeliest fitted; collective.

    Args:
        state: the model with the set that is begun with, compared with all steps.
        begun: the model without effects that were added.
        known: the effects that may be missing.
        starts: further sets to begin with.
        sets: how many sets are weighed; with one set that of the state alone.
        most: how many effects are refitted, before those of which a small part is likelier than these.
        among: of how many effects these were chosen; they are all by default.
        candidates: how they are begun, and what may hold the body in the place of a patch; see there.
    """

    def work(thin: State) -> Contest:
        search = HypothesisSearch(thin, begun, known, sets, among=among)
        promises = search.run(starts) if sets > 1 else search.alone()
        found = refitted(promises, begun, search.among, most, candidates=candidates)
        fitted = {rival.names for rival in found.rivals}
        given = {h: promised for h, promised in search.giving().items() if h.names not in fitted}
        return replace(found, promised=given | found.promised, kept=(*search.kept(), *found.kept))

    return at_a_glance(state, work)


def fitted_beside(state: State, known: Sequence[Effect], most: int) -> list[Rival]:
    """The most promising effects (`most`: see `contest`) beside a model with its set, fitted to all steps; collective."""

    def work(thin: State) -> Contest:
        promises = HypothesisSearch(thin, thin.model, known, 1).alone()
        here = [promise for promise in promises if promise.anchors == state.anchors]
        return refitted(here, thin.model, len(known), most, math.inf)

    found = at_a_glance(state, work).rivals
    here = [rival for rival in found if rival.names and rival.anchors == state.anchors]
    fitted = [rival for rival in (promoted(one, state, state.model) for one in here) if rival]
    return best_first(replace(rival, held_out=held_out(rival.fitted)) for rival in fitted)


def refitted(
    promises: Sequence[Promise],
    begun: Model,
    count: int,
    most: int,
    worth: float = SETTINGS.comparable,
    candidates: Candidates | None = None,
) -> Contest:
    """The models alone, and the most promising of `count` effects with their sets fitted; collective.

    An effect is worth a fit as long as something unknown acts besides the best, and where it promises to be no more than exp(worth)
    times less likely than that, or may turn out to be: by as much as the best did better than it promised, any may.
    What an effect promises is linear in its amount, which a large one is not: each has its best set tried first, and then the one
    that turns out best competes with itself on other sets, also where something unknown is likelier. One that loses on its best set
    is tried on that of what it loses to. Anchors that give or come off do so at a place, which goes with the set: these are tried
    with each set that was looked at for them. Some effects are tried first, with sets and numbers that are given. What may hold
    the body in the place of a patch is tried for each patch of the likely sets. Where none explains all, what is likelier
    in part already is fitted too. Those that may be the likeliest then are compared with the error of the mesh that each has by
    itself.
    """
    starts = candidates.starts if candidates else {}
    promises = _in_turn(promises, starts)
    promised_with = {(p.row.effect, p.anchors): p for p in promises if p.row and math.isfinite(p.row.gain)}
    rivals = [Rival.looked_at(p.look, begun, count) for p in promises if p.row is None]
    stood = _stood_in(rivals, begun, count, candidates) if candidates else []
    rivals += stood
    tried: set[tuple[str, Anchored | None]] = set()
    states: dict[Anchored, State] = {}
    hoped: dict[str, float] = {}
    kept: list[Kept] = []
    for promise in promises:
        row, best = promise.row, best_first(rivals)[0]
        if row is None:
            continue
        what = row.effect, promise.anchors if loosens(row.term.effect) else None
        if what in tried or len(tried) >= most or not math.isfinite(row.gain):
            continue
        # What has a start is fitted whatever explains all before it: it may do so with fewer numbers.
        started = row.effect in starts
        better = max(best.log - hoped.get(best.names[-1], best.log), 0.0) if best.names else 0.0
        if not started and best.complete and promise.log < best.log - better - max(_unlikely(promise), worth):
            continue
        tried.add(what)
        hoped.setdefault(row.effect, promise.log)
        promise.look.state.predictor.progress.step("candidates refitted", len(tried) - 1, most, f"now {row.effect}")
        found = _refit(states, promise, begun, count)
        told = _promised(promise, begun)
        base = promise.look.evidence.plain
        kept += [Kept(told.hypothesis, told.about, told.log, one.evidence.plain, base) for one in found]
        if found and found[0].log < promise.log - SETTINGS.comparable and promise.log > best.log:
            # What breaks its promise on one set may keep it on another.
            found += moved(found[0], begun, count)
        rivals += found
        there = promised_with.get((row.effect, best_first(rivals)[0].anchors))
        if there and there.anchors != promise.anchors and what[1] is None:
            rivals += _refit(states, there, begun, count)
    for promise in _likelier_in_part(promises, {effect for effect, _ in tried}, best_first(rivals)[0], begun, count):
        assert promise.row is not None
        tried.add((promise.row.effect, None))
        rivals += _refit(states, promise, begun, count)
    fitted = {effect for effect, _ in tried}
    rivals = _with_own_mesh(rivals, begun)
    best = best_first(rivals)[0]
    holding = {rival.effect for rival in stood}
    named = [rival for rival in best_first(rivals) if rival.names and rival.names[-1] in fitted | holding]
    if named and (named[0] is best or not best.complete):
        rivals += moved(named[0], begun, count)
    promised = {}
    for promise in promises:
        if promise.row and promise.row.effect not in fitted and math.isfinite(promise.log):
            one = _promised(promise, begun)
            promised[one.hypothesis] = one
    return Contest(best_first(rivals), promised, tuple(kept))


def _promised(promise: Promise, begun: Model) -> Promised:
    """What the tangent of a set says of an effect."""
    assert promise.row is not None
    names = [term.effect.name for term in promise.look.state.model.added(begun)]
    about = Hypothesis(promise.anchors, "+".join(names))
    hypothesis = Hypothesis(promise.anchors, "+".join([*names, promise.row.effect]))
    return Promised(hypothesis, about, promise.evidence, promise.log_prior)


def _likelier_in_part(
    promises: Sequence[Promise], fitted: Container[str], best: Rival, begun: Model, count: int
) -> list[Promise]:
    """Effects that were not fitted but of which a small part is likelier than the best already, the likeliest first.

    Where something unknown is likelier than all that was fitted, one of the others may be so large that its sensitivities tell
    little of it. A prediction with a small part of what they promise tells more; with the set that is likeliest without effects.
    """
    if best.complete:
        return []
    likeliest = next(promise.anchors for promise in promises if promise.row is None)
    likelier = list[tuple[float, Promise]]()
    for promise in promises:
        row = promise.row
        if row is None or promise.anchors != likeliest or row.effect in fitted or not math.isfinite(row.gain):
            continue
        promise.look.state.predictor.progress.step("candidates tried in part", len(likelier), note=f"now {row.effect}")
        log = _log_in_part(promise, begun, count)
        if log > best.log:
            likelier.append((log, promise))
    return [promise for _, promise in sorted(likelier, key=lambda pair: -pair[0])]


def _log_in_part(promise: Promise, begun: Model, count: int) -> float:
    """Logarithm of evidence and prior with a small part of what is promised; minus infinity where that cannot be followed."""
    state, row = promise.look.state, promise.row
    assert row is not None
    try:
        here = state.of_set(promise.anchors, state.model + small_part(row, state.model))
    except (SolveError, InputError):
        return -math.inf
    return Rival.looked_at(Look(here, here.evidence()), begun, count).log


def _stood_in(alone: Sequence[Rival], begun: Model, count: int, candidates: Candidates) -> list[Rival]:
    """What may hold the body in the place of a patch, for each patch of the likely sets, in the likeliest that has it.

    Those with which candidates promise much are likely too: in all steps they are, with something unknown besides.

    Where a patch stands for what holds the body near it no score shows that: without the patch all moves otherwise, and with it
    nothing may be seen to be missing. A fit that begins at the patch gets there, and what holds it in another way is tried there.
    """
    found, done = list[Rival](), set[Anchored]()
    best, begun_with = best_first(alone)[0], {start.anchors for start in candidates.starts.values()}
    for rival in (r for r in best_first(alone) if r.log > best.log - SETTINGS.comparable or r.anchors in begun_with):
        state = rival.fitted.state
        for one in candidates.standing_in(state, begun):
            patch = state.anchors - one.anchors
            if patch not in done:
                done.add(patch)
                state.predictor.progress.step("patches replaced", len(done) - 1)
                found += stood_in(state, one, begun, count)
    if found and (top := best_first(found)[0]).log > best.log:
        without = top.without(top.effect).fitted.state
        for term in candidates.holding_alike(top.term):
            found += stood_in(without, StandIn(top.anchors, term), begun, count)
    return found


def _refit(states: dict[Anchored, State], promise: Promise, begun: Model, count: int) -> list[Rival]:
    """A promised effect fitted, measured by the errors of the set that it makes likely; of these the `states` are kept."""
    anchors, row = promise.anchors, promise.row
    assert row is not None
    try:
        states[anchors] = states.setdefault(anchors, promise.look.state).with_own_errors()
    except SolveError:
        return []
    return refit(states[anchors], row, begun, count)


def _with_own_mesh(rivals: Sequence[Rival], begun: Model) -> list[Rival]:
    """Fitted effects with the error of the mesh at their own numbers: the likeliest first, until one of them does not catch up.

    They were fitted by the error that the mesh has without them. On its likeliest set an effect tells what it gains on others.
    One that was fitted alone has none to catch up with. Where the mesh leaves no notable part of the noise its error changes little
    from one to the other, and those near the likeliest are fitted to all steps with their own.
    """
    first: dict[tuple[str, ...], Rival] = {}
    for rival in best_first(rival for rival in rivals if rival.fitted.coordinates and rival.names):
        first.setdefault(rival.names, rival)
    if len(first) < 2 or not any(_meshed(rival) for rival in first.values()):
        return list(rivals)
    found, most, done = list(rivals), 0.0, set()
    for names, rival in first.items():
        near = rival.log + most > best_first(found)[0].log - SETTINGS.hopeless
        own = with_own_mesh(rival, begun) if near else None
        if own is None:
            continue
        plain, forced = own.evidence.plain - rival.evidence.plain, own.evidence.forced - rival.evidence.forced
        most = max(most, own.log - rival.log)
        alike = [r.gaining(plain, forced) for r in found if r.names == names and r is not rival]
        found = [own, *alike, *(r for r in found if r.names != names)]
        done.add(names)
        top = best_first(found)[0].names
        if top != names and (top in done or top not in first):
            break
    return found


def _meshed(rival: Rival) -> bool:
    """Whether what the mesh leaves is a notable part of the noise."""
    state = rival.fitted.state
    return state.errors.mesh_rms > NOTABLE * state.noise


def _in_turn(promises: Sequence[Promise], starts: Mapping[str, Start]) -> list[Promise]:
    """Promises of effects that have a start first, with its numbers, in the order of the starts; none of them with another set.

    After what promises most of the others comes what explains most on the set that is likeliest with something unknown: other sets
    may promise more that only seem to hold the body in place of what acts.
    """
    first = []
    for name, start in starts.items():
        here = [p for p in promises if p.row and p.row.effect == name and p.anchors == start.anchors]
        first += [replace(p, row=replace(p.row, term=p.row.term.with_values(start.values))) for p in here if p.row]
    own = {p.row.effect for p in first if p.row}
    others = [p for p in promises if p.row and p.row.effect not in own]
    return [
        *(p for p in promises if p.row is None),
        *first,
        *others[:1],
        *_explaining_most(promises, others),
        *others[1:],
    ]


def _explaining_most(promises: Sequence[Promise], others: Sequence[Promise]) -> list[Promise]:
    """Of effects other than the first one the one that makes the likeliest set likelier by most, where something unknown acts."""
    alone = [p for p in promises if p.row is None]
    if not alone or alone[0].look.evidence.plain > alone[0].look.evidence.forced:
        return []
    here = [(p.row.gain, p) for p in others if p.row and p.anchors == alone[0].anchors and math.isfinite(p.row.gain)]
    most = max(here, key=lambda pair: pair[0])[1] if here else None
    return [most] if most and most.row and others[0].row and most.row.effect != others[0].row.effect else []


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
    return min(SETTINGS.comparable + bent * (max(state.chi2 - len(data), 0.0) + row.score) / 2, SETTINGS.hopeless)
