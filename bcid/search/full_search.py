"""The search in all steps: what a few of them leave open is fitted, and the most probable is compared with the same less a part."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Protocol

from bcid.base.errors import InputError, SolveError
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.inference.discrepancy import Evidence
from bcid.inference.hypotheses import Hypothesis, label
from bcid.inference.posterior import Fidelity
from bcid.search.candidates import Candidates
from bcid.search.coarse_search import CoarseSearch
from bcid.search.fitting.curvature import bent
from bcid.search.fitting.fit import Fit, fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis, added, best_first, promoted
from bcid.search.fitting.ranking import Ranking
from bcid.search.fitting.state import FEW_STEPS, State, few_steps, in_few_steps
from bcid.search.hypothesis_table import HypothesisTable
from bcid.search.search_queue import SearchQueue, Task
from bcid.search.settings import SETTINGS

Anchored = frozenset[str]


class SetEvaluator(Protocol):
    """Evaluates sets in all steps where that costs less than to fit them."""

    @property
    def failed(self) -> Collection[Anchored]:
        """Those that could not be followed to the end."""
        ...

    def evidences(
        self, rival: FittedHypothesis, begun: Model, excluded: frozenset[Anchored]
    ) -> Mapping[Anchored, Evidence]:
        """Of the effects of a fitted hypothesis on sets, its own among them, with its numbers and errors; collective.

        `begun` is the model without added effects; `excluded` sets are not asked about. Nothing where none can be evaluated.
        """
        ...


class FullSearch(SearchQueue):
    """Fits hypotheses to all steps; `run` is collective on the ranks of the predictor.

    Args:
        base: the model without added effects, compared with all steps, on a likely set.
        candidates: the effects that may be missing.
        starts: likely sets.
        effects: that may act together, at most.
        fitted: effects that are fitted in a few steps beside each model, each time on one set.
        sets: anchor sets that are compared in a few steps.
        others: evaluates other sets in all steps, where that costs less than to fit them.
        excluded: sets that have lost, as is known from elsewhere: they are no hypotheses.
    """

    def __init__(
        self,
        base: State,
        candidates: Candidates,
        starts: Sequence[Anchored],
        effects: int,
        fitted: int,
        sets: int,
        others: SetEvaluator | None = None,
        excluded: frozenset[Anchored] = frozenset(),
    ) -> None:
        super().__init__(base, HypothesisTable(alike=candidates.alike, excluded=excluded))
        self.others = others
        self.candidates, self.starts, self.most, self.few, self.sets = candidates, tuple(starts), effects, fitted, sets
        # Effects beside which further ones were sought.
        self.extended: set[tuple[str, ...]] = set()
        # What was compared in a few steps, beside each of these models.
        self.stages: list[CoarseSearch] = []
        # What was evaluated, in fits to all steps, and how many failed.
        self.fits = 0.0
        self.failures = 0

    def run(self) -> HypothesisTable:
        self.extend(self.base, self.sets)
        return super().run()

    # -- the order
    # ---------------------------------------------------------------------------------------------------------------

    def affordable(self, hypothesis: Hypothesis) -> bool:
        return max(self.fits, self.failures) < SETTINGS.fits

    def cost(self, hypothesis: Hypothesis) -> float:
        stage = self._stage(hypothesis)
        return stage.cost(hypothesis) if stage else 1.0

    def batch(self, likely: Sequence[Hypothesis]) -> Sequence[Hypothesis]:
        stage = self._stage(likely[0])
        return stage.batch([h for h in likely if self._stage(h) is stage]) if stage else likely[:1]

    def _stage(self, hypothesis: Hypothesis) -> CoarseSearch | None:
        """Where what is known by a tangent can be evaluated in a few steps, which costs less than all."""
        known = self.table.posterior().evaluations.get(hypothesis)
        if known is None or known.fidelity != Fidelity.TANGENT:
            return None
        return next((stage for stage in self.stages[::-1] if stage.takes(hypothesis)), None)

    def question(self, best: FittedHypothesis, likely: Sequence[Hypothesis]) -> Task | None:
        if not best.names and best.hypothesis not in self.rankings:
            # A few steps may show nothing of what remembers, and the errors of another set may hide what an effect explains.
            return partial(self.missing, best)
        if not self.table.sets_about(best.hypothesis):
            return partial(self.ask_sets, best)
        return None

    def last(self, best: FittedHypothesis) -> Task | None:
        doubtful = self.table.doubtful()
        if doubtful is not None and self.affordable(doubtful):
            return partial(self.evaluate, [doubtful])
        if best.hypothesis not in self.table.reduced:
            return partial(self.reduce, best)
        lesser = self.table.unopposed()
        if lesser is not None:
            return partial(self.evaluate, [lesser])
        if best.names and len(best.names) < self.most:
            if best.names not in self.extended:
                return partial(self.extend, best.fitted.state, 1)
            if best.hypothesis not in self.rankings:
                # A few steps leave more room for further effects than all.
                return partial(self.missing, best)
        return None

    # -- evaluations
    # ---------------------------------------------------------------------------------------------------------------

    def evaluate(self, wanted: Sequence[Hypothesis]) -> None:
        """Evaluate what only a tangent tells of in a few steps, and fit all else to all steps."""
        stage = self._stage(wanted[0])
        if stage is not None:
            self.fits += math.fsum(map(stage.cost, wanted))
            stage.evaluate(wanted)
            self.table.reconsider()
            return
        self.predictor.progress.step("hypotheses fitted to all steps", int(self.fits), SETTINGS.fits)
        super().evaluate(wanted)
        failed = len(self.table.refused.intersection(wanted))
        self.failures += failed
        self.fits += len(wanted) - failed
        for rival in (r for r in self.table.full if r.hypothesis in wanted):
            self.say_fitted(rival)

    def ask_sets(self, rival: FittedHypothesis) -> None:
        """What other sets are worth with the effects of a fitted hypothesis: predicted where that is cheap, else by its tangent."""
        if self.others is None:
            super().ask_sets(rival)
            return
        found = self.others.evidences(rival, self.model, self.table.excluded)
        if not found:
            super().ask_sets(rival)
            return
        for anchors in self.others.failed:
            self.table.refuse(Hypothesis(anchors, rival.hypothesis.effect))
        self.table.add_sets(rival, found, Fidelity.SHARED)

    def missing(self, rival: FittedHypothesis) -> Ranking:
        """What a model lacks, as all steps show it."""
        return self.ask_effects(rival, {name: e for name, e in self.effects.items() if name not in rival.names})

    def reduce(self, rival: FittedHypothesis) -> None:
        """Compare a hypothesis in a few steps with the same less one of its patches, where its tangent speaks against these."""
        shown = self.table.sets_about(rival.hypothesis)
        least = shown[rival.anchors].total - SETTINGS.comparable
        unlikely = [anchors for anchors, evidence in shown.items() if evidence.total < least]
        found = rival.without_a_patch(unlikely, few_steps(self.predictor), FEW_STEPS, self.model)
        self.table.reduced[rival.hypothesis] = found

    def extend(self, base: State, sets: int) -> None:
        """Compare sets and effects beside a model in a few steps."""
        self.extended.add(tuple(term.effect.name for term in base.model.added(self.model)))
        self.fits, self.failures = 0.0, 0
        missing = self.candidates.beside(base, self.model, self.starts if sets > 1 else ())
        # What the plain model lacks is known by the effects of the first extension.
        self.effects = {effect.name: effect for effect in missing} | self.effects
        # Where sets are predicted in all steps, a few of them say nothing more of these.
        coarse = self._compared(base, missing, sets) if missing or self.others is None else None
        if not self.table.full:
            self.begin(coarse)
        if coarse is not None:
            self.table.add_stage(coarse)
        self.predictor.drop([self.model, *(rival.fitted.state.model for rival in self.table.full)])

    def _compared(self, base: State, missing: Sequence[Effect], sets: int) -> HypothesisTable | None:
        """What a few steps say; None where they cannot be followed."""
        self.predictor.progress.say(f"comparing anchor sets and effects beside {base.model.name} in a few steps")
        try:
            stage = self._coarse(base, missing, sets)
            found = stage.run()
        except SolveError as error:
            self.predictor.skip(f"sets and effects beside {base.model.name}: {error}")
            return None
        self.stages.append(stage)
        return found

    def _coarse(self, base: State, missing: Sequence[Effect], sets: int) -> CoarseSearch:
        """The search over sets and effects beside a model in a few steps."""
        found = CoarseSearch(
            in_few_steps(base),
            self.model,
            missing,
            self.candidates.among,
            sets,
            self.few,
            self.starts,
            self.candidates,
        )
        found.table.excluded = self.table.excluded
        return found

    def begin(self, coarse: HypothesisTable | None) -> None:
        """Fit the model without effects to all steps, with its likeliest set, or that of the base where this fails."""
        plain = next((rival for rival in coarse.full if not rival.names), None) if coarse else None
        found = promoted(plain, self.base, self.model) if plain else None
        if found is None:
            found = FittedHypothesis.of(_curved(self.base), self.model, self.candidates.among)
        self.say_fitted(found)
        self.table.add([found], self.model)

    # -- how a hypothesis is fitted
    # ---------------------------------------------------------------------------------------------------------------

    def evaluated(self, wanted: Hypothesis) -> FittedHypothesis | None:
        """A hypothesis fitted to all steps, begun at the nearest that is known; None where that fails."""
        names, best = wanted.names, self.table.best()
        more = [name for name in best.names if name not in names]
        if wanted.anchors <= best.anchors and len(more) == 1 and len(names) < len(best.names):
            return promoted(best.without(more[0]), self.base, self.model, anchors=wanted.anchors)
        rough = self.table.roughly(wanted)
        if rough is not None:
            return promoted(rough, self.base, self.model)
        like = next((r for r in self.table.full if r.names == names and r.acts_on(wanted.anchors)), None)
        if like is not None:
            return promoted(like, self.base, self.model, anchors=wanted.anchors)
        parent = next((r for r in self.table.full if r.names == names[:-1]), None)
        return self._added(parent, wanted) if parent and names[-1] in self.effects else None

    def _added(self, parent: FittedHypothesis, wanted: Hypothesis) -> FittedHypothesis | None:
        """A fitted hypothesis with one effect more; None where that fails."""
        state = parent.fitted.state
        try:
            beside = State.of(self.predictor, state.model, wanted.anchors, None, state.free)
            found = added(beside, self.effects[wanted.names[-1]], self.model, self.candidates.among)
            if found is None or found.term.effect.sudden:
                return found
            # By the error of the mesh that the model without it has, a further effect may seem to act.
            own_errors = promoted(found, self.base, self.model)
            return best_first([found, own_errors] if own_errors else [found])[0]
        except (SolveError, InputError):
            return None

    def say_fitted(self, rival: FittedHypothesis) -> None:
        """What is left of the measurement by a hypothesis."""
        state = rival.fitted.state
        anchors = label(state.anchors, self.predictor.scene.patches)
        self.predictor.progress.say(f"  {state.model.name}, anchors {anchors}: {state.rms * 1e3:.3g} mm")


def _curved(base: State) -> Fit:
    """The base with its free numbers fitted, and the curvature of what the scene may have wrong, as far as that is known."""
    found = Fit.at(base)
    with suppress(SolveError):
        found = fit(base, base.free) if base.free else found
    with suppress(SolveError):
        found = bent(found)
    return found
