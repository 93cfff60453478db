"""The search on a few steps of each action: many sets, and the effects that may go with them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial

from scipy.special import logsumexp

from bcid.base.errors import InputError, SolveError
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model, Term
from bcid.inference.hypotheses import Hypothesis
from bcid.search.candidates import Candidates, StandIn, Start
from bcid.search.fitting.fit import fit
from bcid.search.fitting.fitted_hypothesis import ROUGH, FittedHypothesis, best_first, refit_term, stood_in
from bcid.search.fitting.loosened import Loosened, loosened, loosens
from bcid.search.fitting.ranking import rank
from bcid.search.fitting.state import State
from bcid.search.hypothesis_table import HypothesisTable
from bcid.search.search_queue import SearchQueue, Task
from bcid.search.set_tangents import neighbours
from bcid.search.settings import SETTINGS

Anchored = frozenset[str]


class CoarseSearch(SearchQueue):
    """Evaluates sets, and effects beside a model, on a few steps; `run` is collective on the ranks of the predictor.

    Without the effect that is missing a wrong set may fit better than the true one, and without the true set a wrong effect may
    explain more than the missing one. A discrepancy in the place of what is missing lets the true set be seen all the same: sets
    are evaluated first, then effects.

    Args:
        base: the model in a few steps, with a set to begin with.
        model: the one without added effects.
        effects: that may be missing beside the base.
        among: of how many effects these were chosen.
        sets: that are evaluated with the effects of the base, at most.
        fits: effects that are fitted, each time on one set, at most.
        starts: sets to begin with besides.
        candidates: how effects are begun, and what may hold the body in the place of a patch.
    """

    def __init__(
        self,
        base: State,
        model: Model,
        effects: Iterable[Effect] = (),
        among: int | None = None,
        sets: int = 1,
        fits: int = 0,
        starts: Sequence[Anchored] = (),
        candidates: Candidates | None = None,
    ) -> None:
        super().__init__(base, HypothesisTable(alike=bool(candidates and candidates.alike)))
        self.model, self.sets, self.fits = model, sets, fits
        self.effects = {effect.name: effect for effect in effects}
        self.among = len(self.effects) if among is None else among
        self.candidates = candidates
        self.begun: Mapping[str, Start] = candidates.starts if candidates else {}
        # Springs by which a set may give, or when it comes off, as they fit best by the tangent of another.
        self.springs: dict[Hypothesis, Term] = {}
        self._asked_springs: set[Hypothesis] = set()
        self._states: dict[Anchored, State] = {}
        self._replaced = False
        first = FittedHypothesis.unfitted(base, model, self.among)
        self.names = first.names
        self.table.add([first], model)
        if sets > 1:
            effect = first.hypothesis.effect
            self.evaluate([Hypothesis(s, effect) for s in dict.fromkeys(starts) if s != base.anchors])

    # -- the order
    # ---------------------------------------------------------------------------------------------------------------

    def affordable(self, hypothesis: Hypothesis) -> bool:
        plain = hypothesis.names == self.names
        count = sum((r.names == self.names) == plain for r in self.table.own)
        count += sum((h.names == self.names) == plain for h in self.table.refused)
        known = set(hypothesis.names) <= {*self.names, *self.effects}
        return count < (self.sets if plain else self.fits) and known

    def takes(self, hypothesis: Hypothesis) -> bool:
        """Whether it was not evaluated here and can be: with the effects of the base, and perhaps one further."""
        own, further = hypothesis.names[: len(self.names)], hypothesis.names[len(self.names) :]
        known = {r.hypothesis for r in self.table.own} | self.table.refused
        return (
            own == self.names and len(further) <= 1 and self.effects.keys() >= set(further) and hypothesis not in known
        )

    def cost(self, hypothesis: Hypothesis) -> float:
        return SETTINGS.cost_of_set if hypothesis.names == self.names else SETTINGS.cost_of_coarse_fit

    def batch(self, likely: Sequence[Hypothesis]) -> Sequence[Hypothesis]:
        sets = [h for h in likely if h.names == self.names]
        return sets[: SETTINGS.batch] if likely[0] in sets else likely[:1]

    def question(self, best: FittedHypothesis, likely: Sequence[Hypothesis]) -> Task | None:
        unasked_sets = self.sets > 1 and not self.table.sets_about(best.hypothesis)
        # Of effects each is fitted on one set first; of what fits best a tangent then tells more of others than without it.
        if unasked_sets and (not likely or best.names in (self.names, likely[0].names)):
            return partial(self.ask_sets, best)
        if not self.effects or (likely and not self.rankings):
            return None
        plain = [r for r in self.table.full if r.names == self.names]
        unasked = [r for r in plain if r.hypothesis not in self.rankings]
        if unasked:
            return partial(self._ask_all, unasked)
        if plain[0].hypothesis not in self._asked_springs:
            return partial(self.ask_springs, plain[0])
        start = next((name for name in self.begun if name in self.effects and not self._tried(name)), None)
        return partial(self._fit_start, start) if start else None

    def last(self, best: FittedHypothesis) -> Task | None:
        return None if self.candidates is None or self._replaced else partial(self._replace_patches, self.candidates)

    def _tried(self, name: str) -> bool:
        return any(h.names[-1:] == (name,) for h in [*(r.hypothesis for r in self.table.own), *self.table.refused])

    # -- evaluations
    # ---------------------------------------------------------------------------------------------------------------

    def _ask_all(self, unasked: Sequence[FittedHypothesis]) -> None:
        """What models lack: the likeliest by its own sensitivities, others by those, which are about the same."""
        other = {name: effect for name, effect in self.effects.items() if not loosens(effect)}
        for rival in unasked:
            like = next(iter(self.rankings.values()), None)
            self.ask_effects(rival, other, like)

    def ask_springs(self, rival: FittedHypothesis) -> None:
        """Which sets may give, or come off, as the tangent of one shows them."""
        self._asked_springs.add(rival.hypothesis)
        found: dict[Hypothesis, float] = {}
        for effect in (e for e in self.effects.values() if loosens(e)):
            found |= self._springs(rival, effect)
        self.table.add_springs(rival, found)

    def _springs(self, rival: FittedHypothesis, effect: Effect) -> dict[Hypothesis, float]:
        state, measurement = rival.judged, self.predictor.measurement
        if effect.not_applicable(self.predictor.scene, measurement):
            return {}
        every = neighbours(state, self.model, len(self.predictor.scene.patches) <= SETTINGS.loosened_patches)
        near = [s for s in every if len(s ^ state.anchors) <= 2]
        try:
            found = loosened(state, effect, every if self.sets > 1 else near, near)
        except SolveError:
            return {}
        if self.sets == 1:
            found = [one for one in found if one.anchors == state.anchors]
        ways: dict[Hypothesis, list[Loosened]] = {}
        for one in found:
            ways.setdefault(Hypothesis(one.anchors, "+".join([*rival.names, effect.name])), []).append(one)
        # The best fitting comes first.
        self.springs |= {h: some[0].term for h, some in ways.items()}
        return {h: rival.evidence.plain + float(logsumexp([one.gain for one in some])) for h, some in ways.items()}

    def evaluated(self, wanted: Hypothesis) -> FittedHypothesis | None:
        progress, count = self.predictor.progress, len(self.table.own)
        if wanted.names == self.names:
            progress.step("anchor sets evaluated in a few steps", count, self.sets)
            return self._on_set(wanted.anchors)
        progress.step("effects fitted in a few steps", count, note=f"now {wanted.names[-1]}")
        same = (r for r in best_first(self.table.own) if r.names == wanted.names)
        like = next((r for r in same if r.acts_on(wanted.anchors)), None)
        if like is not None:
            return self._moved(like, wanted.anchors)
        begun = self._begun(wanted)
        return self._fitted(wanted.anchors, *begun) if begun else None

    def _on_set(self, anchors: Anchored) -> FittedHypothesis | None:
        try:
            return FittedHypothesis.unfitted(self._state(anchors), self.model, self.among)
        except SolveError:
            return None

    def _state(self, anchors: Anchored) -> State:
        """The model with a set."""
        if anchors not in self._states:
            known = next(
                (r.fitted.state for r in self.table.own if (r.anchors, r.names) == (anchors, self.names)), None
            )
            self._states[anchors] = known or self.base.of_set(anchors)
        return self._states[anchors]

    def _moved(self, like: FittedHypothesis, anchors: Anchored) -> FittedHypothesis | None:
        """A fitted effect on another set, fitted anew from its numbers there."""
        state = like.fitted.state
        try:
            again = fit(state.of_set(anchors), state.free, most=8, ftol=ROUGH)
        except (SolveError, InputError):
            return None
        return FittedHypothesis.of(again, self.model, self.among)

    def _begun(self, wanted: Hypothesis) -> tuple[Term, float] | None:
        """The term with which an effect is begun on a set, and what it is expected to gain; None where nothing is known of it."""
        if wanted in self.springs:
            return self.springs[wanted], -math.inf
        effect = self.effects[wanted.names[-1]]
        about = Hypothesis(wanted.anchors, "+".join(self.names))
        ranking = self.rankings.get(about)
        rows = ranking.rows if ranking else ()
        row = next((r for r in rows if r.effect == effect.name), None)
        if row is None:
            try:
                rows = rank(self._state(wanted.anchors), [effect], strict=False).rows
            except SolveError:
                return None
            row = rows[0] if rows else None
        return None if row is None else (row.term, row.gain)

    def _fitted(self, anchors: Anchored, term: Term, gain: float) -> FittedHypothesis | None:
        """An effect beside the model, by the errors of the set that it makes likely."""
        try:
            state = self._state(anchors).with_own_errors()
        except SolveError:
            return None
        found = refit_term(state, term, gain, self.model, self.among)
        return found[0] if found else None

    def _fit_start(self, name: str) -> None:
        """An effect from where it is to begin."""
        start = self.begun[name]
        h = Hypothesis(start.anchors, "+".join([*self.names, name]))
        begun = self._begun(h)
        found = self._fitted(start.anchors, begun[0].with_values(start.values), begun[1]) if begun else None
        if found is None:
            self.table.refuse(h)
        else:
            self.table.add([found], self.model)

    def _replace_patches(self, candidates: Candidates) -> None:
        """What may hold the body in the place of a patch, for each patch of the likely sets, in the likeliest that has it.

        Where a patch stands for what holds the body near it no score shows that: without the patch all moves otherwise, and with it
        nothing may be seen to be missing. A fit that begins at the patch gets there, and what holds it in another way is tried
        there.
        """
        self._replaced = True
        plain = [r for r in self.table.full if r.names == self.names]
        begun_with = {start.anchors for start in self.begun.values()}
        found, done = list[FittedHypothesis](), set[Anchored]()
        for rival in (r for r in plain if r.log > plain[0].log - SETTINGS.comparable or r.anchors in begun_with):
            state = rival.fitted.state
            for one in candidates.standing_in(state, self.model):
                patch = state.anchors - one.anchors
                if patch not in done:
                    done.add(patch)
                    self.predictor.progress.step("patches replaced", len(done) - 1)
                    found += stood_in(state, one, self.model, self.among)
        if found and (top := best_first(found)[0]).log > plain[0].log:
            without = top.without(top.effect).fitted.state
            for term in candidates.holding_alike(top.term):
                found += stood_in(without, StandIn(top.anchors, term), self.model, self.among)
        self.table.add(found, self.model)
