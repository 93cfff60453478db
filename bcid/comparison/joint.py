"""Anchors and effects as rivals: anchor sets are climbed on by what they leave, alone or once the best effect is added.

Without the effect that is missing, a wrong set may fit better than the true one, and without the true set a wrong effect
may explain more than the missing one. So a set is judged by the smallest chi-square that it leaves, or that any effect
promises with it: one prediction and one ranking per set, for which a few steps of each action are enough
(`State.thinned`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bcid.base.errors import SolveError
from bcid.comparison.ranking import SIGNIFICANT, Ranking, rank
from bcid.comparison.state import State
from bcid.forms.effects.effect import Effect
from bcid.search.climb import neighbours

Anchored = frozenset[str]
# Chi-square per value below which a model is nearly adequate.
NEARLY = 1.3
# A set that leaves so many times what the best one promises is not ranked: no effect makes up for that. Where one is nearly
# adequate as it is, the sets are told apart without.
_HOPELESS, _TOLD_APART = 12.0, 3.0
# From a second set it is climbed when that leaves at most so many times the least.
_NEAR = 1.1


@dataclass(frozen=True)
class Proposal:
    """An effect, and the set of anchors that it would go with.

    Attributes:
        anchors: the set.
        effect, place: what acts, and where; None when the model is left as it is.
        left: chi-square that it promises to leave, with a penalty for its numbers (Schwarz 1978).
        values: number of values that it was compared with.
    """

    anchors: Anchored
    effect: Effect | None
    place: str
    left: float
    values: int


def promised(state: State, ranking: Ranking, more: float = 0.0) -> list[Proposal]:
    """What the significant effects of a ranking promise, best first; `more` is left besides what the ranking says."""
    size = len(state.predictor.data)
    rows = [row for row in ranking.rows if row.p_value < SIGNIFICANT]
    left = [more + ranking.left - row.score + row.dof * math.log(size) for row in rows]
    found = [Proposal(state.anchors, r.term.effect, r.term.place, n, size) for r, n in zip(rows, left, strict=True)]
    return sorted(found, key=lambda p: p.left)


def propose(state: State, others: Iterable[Anchored], most: int, known: Sequence[Effect]) -> list[Proposal]:
    """Effects and anchor sets that together promise to leave the least, best first; collective.

    Args:
        state: the model, and the set to climb from.
        others: further sets to climb from.
        most: how many sets are looked at.
        known: the effects to look at.
    """
    climb = _Climb(state, most, known)
    climb.up(state.anchors)
    for start in others:
        climb.look(start)
        if climb.left(start) < _NEAR * min(map(climb.left, climb.known)):
            climb.up(start)
    found = [proposal for proposals in climb.known.values() for proposal in proposals]
    return sorted(found, key=lambda p: p.left)


class _Climb:
    """Looks at anchor sets, each once."""

    def __init__(self, state: State, most: int, known: Sequence[Effect]) -> None:
        self.state, self.most, self.effects = state, most, known
        self.known: dict[Anchored, list[Proposal]] = {}

    def up(self, start: Anchored) -> None:
        """From a set to its best neighbour, until none is better."""
        best = start
        while True:
            around = [best, *neighbours(best, list(self.state.predictor.scene.patches))]
            for anchors in around:
                self.look(anchors)
            top = min(around, key=self.left)
            if self.left(top) >= self.left(best):
                return
            best = top

    def left(self, anchors: Anchored) -> float:
        """The least that any effect promises with a set."""
        return min((p.left for p in self.known.get(anchors, [])), default=math.inf)

    def look(self, anchors: Anchored) -> None:
        """Rank the effects with a set."""
        if anchors in self.known or not anchors or len(self.known) >= self.most:
            return
        self.state.predictor.progress.step("anchor sets, with the best effect for each", len(self.known), self.most)
        self.known[anchors] = []
        try:
            state = State.of(self.state.predictor, self.state.model, anchors, self.state.errors.mesh, self.state.free)
        except SolveError:
            return
        alone = min((p.left for found in self.known.values() for p in found if p.effect is None), default=math.inf)
        nearly = alone < NEARLY * len(state.predictor.data)
        if state.chi2 < (_TOLD_APART if nearly else _HOPELESS) * min(map(self.left, self.known)):
            ranking = rank(state, self.effects, strict=False)
            # Sets allow for different errors, which they pay for; against the first, so that what is left remains a chi-square.
            more = state.allowance - self.state.allowance
            plain = Proposal(anchors, None, "", ranking.left + more, len(state.predictor.data))
            self.known[anchors] = [plain, *promised(state, ranking, more)]
