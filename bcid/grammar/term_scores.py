"""Which terms of the grammar may be missing: their scores from one converged run, without an assembly for each."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.options import KINDS
from bcid.forms.effects.effect import Effect
from bcid.forms.forward import Forward
from bcid.forms.model import Model, Term
from bcid.forms.probes import Sensitivities, SensitivityRequest
from bcid.grammar.effect_file import made, source
from bcid.grammar.family import OBSERVATION, Family
from bcid.grammar.grammar import Grammar, TermVariant
from bcid.grammar.holds import Grip, held_by
from bcid.grammar.observation_terms import observation_terms, observed_variant, picture_is_told
from bcid.grammar.pulled import gripper_moves, pulled_families, pulled_variants
from bcid.grammar.timed import steady_variants, timed_families, variants_in_time
from bcid.inference.priors import PRIORS
from bcid.search.candidates import StandIn, Start
from bcid.search.coarse_search import CoarseSearch
from bcid.search.fitting.ranking import Row, best_row, orthonormal, present_columns
from bcid.search.fitting.state import State, in_few_steps
from bcid.search.fitting.variants import Variant, amounts

Array = NDArray[np.float64]
Anchored = frozenset[str]
# Terms are scored with so many likely sets; so many are fitted, with a set no more than these of one kind, and of those in time.
_SETS, FITTED, _ALIKE, _TIMED = 3, 8, 4, 2
# So many sets are looked at for them.
_WIDENED = 14
# Families that promise less than this part of the log-evidence that the best of a set does are not fitted.
_PART = 0.4
# Stiffnesses of springs, in notable ones, whose effect is far from proportional to them; what they do is a push on the same spot.
_STIFFNESSES, _PUSH = (0.3, 3.0, 30.0, 300.0), "traction_at_a_spot"
# What does to a place what an anchor does to a patch.
_HOLD = "spring_at_a_spot"
GRIPS = {
    "spring_at_a_spot": Grip(),
    "normal_spring_at_a_spot": Grip(along=False),
    "outer_stop_at_a_spot": Grip(along=False, side=1),
    "inner_stop_at_a_spot": Grip(along=False, side=-1),
}
# A set that is exp(_FAR) times less likely with something unknown besides is left out.
_FAR = 12.0


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
        starts: with which sets and numbers they were promising.
        scored: how many terms there are, all shapes and places counted.
    """

    def __init__(self, kinds: Sequence[str] = KINDS) -> None:
        self.kinds = kinds
        self.stages: dict[str, list[ScoredFamily]] = {}
        self.families: dict[str, Family] = {}
        self.starts: dict[str, Start] = {}
        self._grammar: tuple[Forward, Grammar] | None = None
        self._families = 1
        self.scored = 0

    @property
    def among(self) -> int:
        """How many families there are."""
        return self._families

    @property
    def alike(self) -> bool:
        """They are: which form an energy has, few data tell, and less that it is one at all."""
        return True

    def beside(self, state: State, begun: Model, sets: Sequence[Anchored]) -> list[Effect]:
        """The most promising terms beside a model with its set, or with others; collective."""
        found = [self.scored_families(about) for about in _alike([state, *_others(state, begun, sets)])]
        self.stages[state.model.name] = _best_of(found)
        effects = []
        for one in _in_turns(found):
            name = _entered(one.family, state, begun)
            self.families[name] = one.family
            self.starts[name] = Start(one.anchors, one.row.term.values)
            effects.append(one.effect(name))
        return effects

    def standing_in(self, state: State, begun: Model) -> list[StandIn]:
        """Springs about the middle of each anchored patch, as stiff as any that are believed."""
        grammar = self._of(state)
        family = next((f for f in grammar.families if f.name == _HOLD), None)
        if family is None:
            return []
        name, (stiffness,) = _entered(family, state, begun), family.amounts
        self.families[name] = family
        found = []
        for patch in sorted(state.anchors & set(grammar.surfaces)):
            values = {stiffness.name: PRIORS.widest * stiffness.scale} | grammar.about(patch)
            found.append(StandIn(state.anchors - {patch}, Term(made(source(family, name, values, "", ())), values)))
        return found

    def holding_alike(self, term: Term) -> list[Term]:
        """Springs that act along some directions only, or one way, of the same stiffness about the same place."""
        assert self._grammar is not None
        found = []
        for family in (f for f in self._grammar[1].families if f.name in GRIPS and f.name != _HOLD):
            name = term.effect.name.replace(_HOLD, family.name, 1)
            self.families[name] = family
            found.append(Term(made(source(family, name, term.values, "", ())), term.values))
        return found

    def scored_families(self, state: State) -> list[ScoredFamily]:
        """Every family with its best term, beside a model with its set; collective."""
        grammar = self._of(state)
        predictor, data = state.predictor, state.predictor.data
        predictor.progress.say(f"scoring {len(grammar.variants)} terms beside {state.model.name}")
        found = predictor.sensitivities(state.model, state.anchors, state.prediction, SensitivityRequest(terms=grammar))
        assert found.terms is not None
        columns = state.errors.whiten(np.nan_to_num(data.vector(found.terms).astype(float)))
        parts: list[Any] = np.split(columns, grammar.ends[:-1], axis=1)
        basis = orthonormal(present_columns(state))
        plain = state.evidence().plain
        ways: dict[str, list[Variant]] = {}
        for variant, part in zip(grammar.variants, parts, strict=True):
            ways.setdefault(variant.family.name, []).append(_variant(grammar, variant, part))
        timed = timed_families(state, grammar.families, self.kinds)
        ways |= steady_variants(state, timed)
        for family in timed:
            if family.steady in ways:
                ways[family.name] = variants_in_time(state, family, ways[family.steady])
        pulled = pulled_families(grammar.families) if gripper_moves(state) else []
        for family in pulled:
            ways[family.name] = pulled_variants(state, ways[family.steady], grammar.like(family))
        seen = observation_terms() if OBSERVATION in self.kinds and picture_is_told(state) else []
        for family in seen:
            ways[family.name] = [observed_variant(state, grammar.term(TermVariant(family)))]
        families = [*grammar.families, *timed, *pulled, *seen]
        self._families, self.scored = len(families), sum(len(ways.get(f.name, ())) for f in families)
        result = []
        for family in families:
            own = ways.get(family.name, [])
            if family.name in GRIPS:
                own += self._held(state, grammar, family, found)
            if own:
                row = best_row(state, family.name, own, basis, self.scored)
                result.append(ScoredFamily(family, row, state.anchors, plain + row.gain))
        return result

    def _held(self, state: State, grammar: Grammar, family: Family, found: Sensitivities) -> list[Variant]:
        """Springs that are stiff: per unit of stiffness what those of a given one do."""
        assert found.terms is not None
        assert found.held is not None
        pushes = {
            tuple(v.shapes.values()): grammar.ends[k] for k, v in enumerate(grammar.variants) if v.family.name == _PUSH
        }
        scale, made_of = family.amounts[0].scale, list[tuple[TermVariant, Array]]()
        grip = GRIPS[family.name]
        for number, spot in enumerate(grammar.held_spots):
            end, area = pushes[tuple(spot.values())], grammar.areas[number]
            # Per unit of force, not of traction.
            pushed = found.terms[..., end - 3 : end].astype(float) / area
            for part in _STIFFNESSES:
                forces = held_by(part * scale, area, found.held[:, number], grammar.normals[number], grip)
                moved = np.einsum("fpaj,fj->fpa", np.nan_to_num(pushed), forces) / (part * scale)
                made_of.append((TermVariant(family, spot), state.predictor.data.vector(moved)))
        columns = state.errors.whiten(np.column_stack([column for _, column in made_of]))
        return [_variant(grammar, v, c[:, None]) for (v, _), c in zip(made_of, columns.T, strict=True)]

    def _of(self, state: State) -> Grammar:
        """The grammar on the mesh of a state."""
        forward = state.predictor.forward(state.model)
        if self._grammar is None or self._grammar[0] is not forward:
            self._grammar = forward, Grammar(forward, self.kinds)
        return self._grammar[1]


def _entered(family: Family, state: State, begun: Model) -> str:
    """Name of the effect that a family makes beside a model: it may act twice, as fibres in two directions."""
    number = len(state.model.added(begun)) + 1
    return family.name if number == 1 else f"{family.name}_{number}"


def _variant(grammar: Grammar, variant: TermVariant, columns: Array) -> Variant:
    term = grammar.term(variant)
    return Variant(term, tuple(amounts(term, [p.name for p in variant.family.amounts])), columns)


def _others(state: State, begun: Model, sets: Sequence[Anchored]) -> list[State]:
    """The same model with other likely sets, as far as it can be followed with them.

    Where the first sets are wrong the right one is found about them: something unknown explains the most beside it.
    """
    if not sets:
        return []
    likely = CoarseSearch(in_few_steps(state), begun, sets=_WIDENED, starts=sets).run().full
    found = []
    for anchors in [r.anchors for r in likely if r.anchors != state.anchors][: _SETS - 1]:
        with suppress(SolveError):
            found.append(state.of_set(anchors))
    return found


def _alike(states: Sequence[State]) -> list[State]:
    """Those that may be as likely as the best with something unknown besides, the likeliest first.

    A term that does much does more than its score tells: with another set, which does some of it, it may promise more.
    """
    forced = {id(state): state.evidence().forced for state in states}
    best = max(forced.values())
    return sorted((s for s in states if forced[id(s)] > best - _FAR), key=lambda s: -forced[id(s)])


def _best_of(found: Sequence[Sequence[ScoredFamily]]) -> list[ScoredFamily]:
    """Every family where it promises most, the most promising first."""
    best: dict[str, ScoredFamily] = {}
    for one in (one for some in found for one in some):
        if one.family.name not in best or one.log > best[one.family.name].log:
            best[one.family.name] = one
    return sorted(best.values(), key=lambda s: (-s.log, s.family.name))


def _in_turns(found: Sequence[Sequence[ScoredFamily]]) -> list[ScoredFamily]:
    """So many families as are fitted: sets take turns, each with what promises most there; not all of one kind."""
    waiting = [_promising(some) for some in found]
    chosen: list[ScoredFamily] = []
    while any(waiting) and len(chosen) < FITTED:
        for some in waiting:
            usable = [s for s in some if np.isfinite(s.log) and _fits_in(s, chosen)]
            some[:] = usable[1:]
            chosen += usable[:1]
    return chosen[:FITTED]


def _promising(found: Sequence[ScoredFamily]) -> list[ScoredFamily]:
    """Families that promise more than a part of the most with a set, the most promising first."""
    most = max((one.row.gain for one in found), default=0.0)
    return sorted((one for one in found if one.row.gain > _PART * most), key=lambda s: (-s.log, s.family.name))


def _fits_in(one: ScoredFamily, chosen: Sequence[ScoredFamily]) -> bool:
    """Whether a family is not chosen yet, nor too many of its kind, or with a course in time, with its set."""
    timed = bool(one.family.times)
    with_set = [c.family for c in chosen if c.anchors == one.anchors and bool(c.family.times) == timed]
    same = len(with_set) if timed else sum(family.kind == one.family.kind for family in with_set)
    new = all(c.family.name != one.family.name for c in chosen)
    return new and same < (_TIMED if timed else _ALIKE)
