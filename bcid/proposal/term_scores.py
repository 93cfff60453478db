"""Which terms of the grammar may be missing: their scores from one converged run, without an assembly for each."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.comparison.ranking import Row, best_row, orthonormal, present_columns
from bcid.comparison.state import State
from bcid.comparison.variants import Variant, amounts
from bcid.forms.effects.effect import Effect
from bcid.forms.forward import Forward
from bcid.forms.model import Model
from bcid.forms.sensitivity import Wanted
from bcid.inference.criteria import SEEN
from bcid.proposal.effect_file import made, source
from bcid.proposal.family import Family
from bcid.proposal.grammar import KINDS, Grammar, TermVariant

Array = NDArray[np.float64]
Anchored = frozenset[str]
# Of so many likely sets terms are scored; so many terms of each are fitted, of one kind no more than these.
_SETS, _FITTED, _ALIKE = 3, 6, 3


@dataclass(frozen=True)
class ScoredFamily:
    """A family as its best term promises to explain what a model leaves.

    Attributes:
        family: of the term.
        row: its best variant, with the expected values, and what it would explain.
        anchors: the set with which it does.
        log: logarithm of how likely it makes the data, with the set.
    """

    family: Family
    row: Row
    anchors: Anchored
    log: float

    def effect(self, name: str) -> Effect:
        """As an effect of this name, whose shapes begin where they were found."""
        term = self.row.term
        return made(source(self.family, name, term.values, term.place, ()))


class TermScores:
    """Candidates from the grammar. Keeps what was found at each stage.

    Args:
        kinds: of terms that are tried.

    Attributes:
        stages: what each model lacked, by its name, the most promising first.
        families: of the candidates, by the names of their effects.
        scored: how many terms there are, all shapes and places counted.
    """

    def __init__(self, kinds: Sequence[str] = KINDS) -> None:
        self.kinds = kinds
        self.stages: dict[str, list[ScoredFamily]] = {}
        self.families: dict[str, Family] = {}
        self._grammar: tuple[Forward, Grammar] | None = None
        self._families = 1
        self.scored = 0

    @property
    def among(self) -> int:
        """How many families there are."""
        return self._families

    def beside(self, state: State, begun: Model, sets: Sequence[Anchored]) -> list[Effect]:
        """The most promising terms beside a model with its set, or with others; collective."""
        best: dict[str, ScoredFamily] = {}
        for about in [state, *_others(state, sets)]:
            for found in self.scored_families(about):
                name = found.family.name
                if name not in best or found.log > best[name].log:
                    best[name] = found
        order = sorted(best.values(), key=lambda s: (-s.log, s.family.name))
        self.stages[state.model.name] = order
        chosen: list[ScoredFamily] = []
        for one in order:
            if np.isfinite(one.log) and sum(c.family.kind == one.family.kind for c in chosen) < _ALIKE:
                chosen.append(one)
        # A family may act twice, as fibres in two directions.
        entered = len(state.model.added(begun)) + 1
        effects = []
        for one in chosen[:_FITTED]:
            name = one.family.name if entered == 1 else f"{one.family.name}_{entered}"
            self.families[name] = one.family
            effects.append(one.effect(name))
        return effects

    def scored_families(self, state: State) -> list[ScoredFamily]:
        """Every family with its best term, beside a model with its set; collective."""
        grammar = self._of(state)
        predictor, data = state.predictor, state.predictor.data
        predictor.progress.say(f"scoring {len(grammar.variants)} terms beside {state.model.name}")
        found = predictor.sensitivities(state.model, state.anchors, state.prediction, Wanted(terms=grammar))
        assert found.terms is not None
        columns = state.errors.whiten(np.nan_to_num(data.vector(found.terms).astype(float)))
        parts: list[Any] = np.split(columns, grammar.ends[:-1], axis=1)
        basis = orthonormal(present_columns(state))
        plain = state.evidence().plain
        result = []
        for family in grammar.families:
            own = [_variant(grammar, v, c) for v, c in zip(grammar.variants, parts, strict=True) if v.family is family]
            if own:
                row = best_row(state, family.name, own, basis, len(grammar.variants), SEEN)
                result.append(ScoredFamily(family, row, state.anchors, plain + row.gain))
        return result

    def _of(self, state: State) -> Grammar:
        """The grammar on the mesh of a state."""
        forward = state.predictor.forward(state.model)
        if self._grammar is None or self._grammar[0] is not forward:
            self._grammar = forward, Grammar(forward, self.kinds)
            self._families = len(self._grammar[1].families)
            self.scored = len(self._grammar[1].variants)
        return self._grammar[1]


def _variant(grammar: Grammar, variant: TermVariant, columns: Array) -> Variant:
    term = grammar.term(variant)
    return Variant(term, tuple(amounts(term, [p.name for p in variant.family.amounts])), columns)


def _others(state: State, sets: Sequence[Anchored]) -> list[State]:
    """The same model with other likely sets, as far as it can be followed with them."""
    found = []
    for anchors in [s for s in sets if s != state.anchors][: _SETS - 1]:
        with suppress(SolveError):
            found.append(state.of_set(anchors))
    return found
