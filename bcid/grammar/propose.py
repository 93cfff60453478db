"""Which term explains a measurement that no known effect does.

Found in the grammar, fitted in full, and weighed against nothing and against something unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.base.options import ExplainOptions, ProposeOptions
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model, Term
from bcid.grammar.family import Family
from bcid.grammar.term_scores import FITTED, ScoredFamily, TermScores
from bcid.inference.thresholds import THRESHOLDS
from bcid.predict.predictor import Predictor
from bcid.search.answer.adequacy import judge
from bcid.search.answer.explanation import Explanation, ModelStep, explained
from bcid.search.explain import explain
from bcid.search.fitting.fit import Fit, fit
from bcid.search.fitting.ranking import Ranking
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
# Anchor sets that are weighed: those that are likely with something unknown besides.
_SETS = 12
# So many families are told as rows of the ranking.
_RANKED = 20


@dataclass(frozen=True)
class Entry:
    """How a term came into the model.

    Attributes:
        family: of the term.
        beside: name of the model that it was added to.
        competed: what was promised of all families there, the likeliest first.
        rms: residual with it, m; None where it was only fitted together with the next.
    """

    family: Family
    beside: str
    competed: tuple[ScoredFamily, ...]
    rms: float | None


@dataclass(frozen=True)
class Proposal:
    """What was found.

    Attributes:
        explanation: anchors and terms as hypotheses, weighed.
        path: how each term came in, in their order; empty where nothing is proposed.
        ranked: what was promised of all families beside the model that was begun with, the likeliest first.
        scored: terms that were scored, all shapes and places counted.
    """

    explanation: Explanation
    path: tuple[Entry, ...]
    ranked: tuple[ScoredFamily, ...]
    scored: int

    @property
    def terms(self) -> tuple[Term, ...]:
        """The proposed terms, with their values, as the search had them."""
        last, first = self.explanation.last.state.model, self.explanation.rungs[0].state.model
        return last.added(first) if self.path else ()

    @property
    def missing(self) -> float:
        """Probability that something else is missing besides, which no term of the grammar explains."""
        return self.explanation.odds.verdicts["unknown"]

    @property
    def complete(self) -> bool:
        """Whether hardly anything else can be missing."""
        return bool(self.path) and self.missing <= 1 - THRESHOLDS.credible

    @property
    def explained(self) -> float:
        """Share of what is beyond the errors that the terms explain, with the anchors of the last model."""
        rungs = self.explanation.rungs
        held = rungs[-1].state.anchors
        same = next((r for r in rungs if not r.state.free and r.state.anchors == held), rungs[0])
        return explained(same.fitted, rungs[-1].fitted)

    def stderr(self, term: Term) -> dict[str, float]:
        """Standard errors of a term's numbers."""
        found = self.explanation.last.fitted.stderr
        return {p.name: found[term.full(p.name)] for p in term.effect.parameters if term.full(p.name) in found}


def propose(predictor: Predictor, model: Model, options: ProposeOptions | None = None) -> Proposal:
    """Find anchors and terms of the grammar until nothing is missing, or say that none explains the data; collective.

    Args:
        predictor: of the measurement.
        model: to add terms to.
        options: how far to go.

    Raises:
        InputError: the body is a sheet that wrinkles.
        SolveError: the model cannot be followed for any anchor set.
    """
    if model.wrinkles:
        rule = "explain the measurement with the known effects instead (bcid explain), or leave geometry.wrinkles out"
        raise InputError(f"terms of the grammar are scored on a body that stays flat, and this sheet wrinkles: {rule}")
    options = options or ProposeOptions()
    scores = TermScores(options.kinds)
    found = explain(
        predictor,
        ExplainOptions(options.level, options.max_effects, fitted=FITTED, sets=_SETS),
        model,
        candidates=scores,
    )
    return Proposal(found, _path(found, scores), tuple(scores.stages.get(model.name, ())), scores.scored)


def _path(found: Explanation, scores: TermScores) -> tuple[Entry, ...]:
    """How the terms of the last model came in; nothing where no term is believed in."""
    best = found.odds.best
    first, last = found.rungs[0].state.model, found.last.state.model
    added = last.added(first)
    if not added or not best.effect:
        return ()
    entries, model = list[Entry](), first
    for term in added:
        competed = tuple(scores.stages.get(model.name, ()))
        family = scores.families[term.effect.name]
        beside, model = model.name, model + term
        rms = next((rung.state.rms for rung in found.rungs if rung.state.model.name == model.name), None)
        entries.append(Entry(family, beside, competed, rms))
    return tuple(entries)


def ladder(proposal: Proposal, effects: Sequence[Effect]) -> tuple[ModelStep, ...]:
    """The models in turn, the last with the effects that were written; families are ranked beside the first; collective."""
    rungs = list(proposal.explanation.rungs)
    if proposal.ranked:
        at = next(number for number, rung in enumerate(rungs) if rung.ranking is not None)
        rows = tuple(one.row for one in proposal.ranked[:_RANKED])
        rungs[at] = replace(rungs[at], ranking=Ranking(rows, {}, proposal.scored))
    if effects:
        rungs[-1] = as_written(proposal, effects)
    return tuple(rungs)


def as_written(proposal: Proposal, effects: Sequence[Effect]) -> ModelStep:
    """The last model with the effects that were written for its terms, fitted again: what a user of their files gets; collective.

    Args:
        proposal: what was found.
        effects: one for each term, in their order.
    """
    last = proposal.explanation.last
    state, model = last.state, last.state.model
    names = dict[str, str]()
    for term, effect in zip(proposal.terms, effects, strict=True):
        written = Term(effect, term.values, place=term.place)
        names |= {term.full(p.name): written.full(p.name) for p in effect.parameters}
        model = replace(model, terms=tuple(written if t is term else t for t in model.terms))
    free = tuple(names.get(name, name) for name in state.free)
    again: Fit = fit(State.of(state.predictor, model, state.anchors, state.errors.mesh, free), free, most=4)
    # The files hold the same terms: what one action tells of another is as the search had it.
    return ModelStep(again, judge(again.state), last.held_out)
