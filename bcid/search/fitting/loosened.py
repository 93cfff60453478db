"""Anchors that give or come off: which set, which of its patches, how soft or when, as the tangent of a followed set shows it.

A spring bed in the place of a rigid hold is a compliance between the tractions on a patch and its movement. What it does is known
to first order however soft it is, from the tangent (`bcid.forms.set_tangent`); the sensitivity to a compliance from none holds for
stiff ones only. A patch that comes off leaves two sets, one before and one after: neither need fit the whole, and a third that does
so a little better hides both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from bcid.forms.effects.effect import Effect
from bcid.forms.model import Term
from bcid.search.fitting.parameter_priors import log_variants
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
Anchored = frozenset[str]
# Stiffnesses that are looked at, in notable ones, all equally likely.
_SIZES = np.geomspace(0.04, 27.0, 6)


@dataclass(frozen=True)
class Loosened:
    """A set of anchors, some or all of which give, or one of which comes off.

    Attributes:
        anchors: the set.
        term: the effect with its place and numbers.
        moved: scaled movement of the values against the set that was followed, shape (n,).
        chi2: of the residual then.
        gain: logarithm of how much likelier it makes the data than that set, its places and numbers being equally likely.
    """

    anchors: Anchored
    term: Term
    moved: Array
    chi2: float
    gain: float

    @property
    def order(self) -> tuple[float, int, list[str], str]:
        """The best fitting first."""
        return self.chi2, len(self.anchors), sorted(self.anchors), self.term.place


def loosens(effect: Effect) -> bool:
    """Whether an effect holds anchored patches by springs instead, or lets them go."""
    return bool(effect.held) or (effect.frees and len(effect.amounts) == 1 and effect.amounts[0].reciprocal)


def slackens(effect: Effect) -> bool:
    """Whether an effect holds whole patches by springs instead, so that without stiffness they are free."""
    return loosens(effect) and effect.held is None and effect.share is None


def loosened(state: State, effect: Effect, sets: Sequence[Anchored], near: Sequence[Anchored]) -> list[Loosened]:
    """Sets that give or come off, the best fitting first; collective.

    Args:
        state: the set that was followed.
        effect: see `loosens`.
        sets: those that are looked at.
        near: of which single patches give.
    """
    if not any(sets):
        return []
    found = _released(state, effect, sets) if effect.held else _yielding(state, effect, sets, near)
    return sorted(found, key=lambda one: one.order)


def _yielding(state: State, effect: Effect, whole: Sequence[Anchored], parts: Sequence[Anchored]) -> list[Loosened]:
    """Springs in the place of whole sets, and of single patches of some."""
    predictor, ways = state.predictor, _ways(effect)
    # What holds along a direction of its surface does not give.
    giving = {s: [patch for patch in sorted(s) if predictor.scene.held_along(patch)] for s in (*whole, *parts)}
    places = {s: effect.places(predictor.scene, s) if effect.places else [""] for s, some in giving.items() if some}
    # All patches of a set give, or a single one of few sets.
    asked = [(s, place) for s, some in places.items() for place in some if not place or s in parts]
    cases = [(anchors, Term(effect, values, place=place)) for anchors, place in asked for values in ways]
    if not cases:
        return []
    soft = [dict.fromkeys([term.place] if term.place else giving[anchors], term) for anchors, term in cases]
    moves = predictor.moves(state.model, state.anchors, state.prediction, [anchors for anchors, _ in cases], soft)
    columns = state.errors.whiten(np.column_stack([predictor.data.vector(moved) for moved in moves]))
    return [
        _one(state, anchors, term, column, len(ways) * len(places[anchors]))
        for (anchors, term), column in zip(cases, columns.T, strict=True)
    ]


def _ways(effect: Effect) -> list[dict[str, float]]:
    """Numbers with which springs are tried."""
    (amount,) = effect.amounts
    shapes = list(product(*(p.scan for p in effect.shapes)))
    names = [p.name for p in effect.shapes]
    return [
        {amount.name: float(size * amount.scale), **dict(zip(names, one, strict=True))}
        for size in _SIZES
        for one in shapes
    ]


def _released(state: State, effect: Effect, sets: Sequence[Anchored]) -> list[Loosened]:
    """Each patch of each set comes off, in the frame in which that fits best: what is seen then is what the others show."""
    followed = dict.fromkeys([*sets, *(s - {place} for s in sets for place in s)])
    moves = state.predictor.moves(state.model, state.anchors, state.prediction, list(followed))
    until = {s: _until(state, moved) for s, moved in zip(followed, moves, strict=True)}
    (switch,), (onset,) = effect.amounts, effect.shapes
    found = []
    for anchors in sets:
        for place in sorted(anchors):
            rest = until[anchors - {place}]
            columns = until[anchors][:, 1:-1] + rest[:, -1:] - rest[:, 1:-1]
            squares = np.sum((state.scaled[:, None] - columns) ** 2, axis=0)
            best = int(np.argmin(squares))
            values = {switch.name: 1.0, onset.name: float(state.predictor.numbers[best + 1])}
            term = Term(effect, values, place=place)
            found.append(_one(state, anchors, term, columns[:, best], len(anchors) * len(squares)))
    return found


def _until(state: State, moved: Array) -> Array:
    """Scaled movements that last until each frame, and to the end, shape (n, frames + 1), from those in all frames."""
    data = state.predictor.data
    lasts = np.arange(len(moved) + 1) > data.frame[:, None]
    return state.errors.whiten(data.vector(moved)[:, None] * lasts)


def _one(state: State, anchors: Anchored, term: Term, moved: Array, cases: int) -> Loosened:
    """One of so many equally likely cases of a set."""
    chi2 = float(np.sum((state.scaled - moved) ** 2))
    return Loosened(anchors, term, moved, chi2, (state.chi2 - chi2) / 2 + log_variants(cases))
