"""Anchors that give: which set, which of its patches, and how soft, as the tangent of a set that was followed shows it.

A spring bed in the place of a rigid hold is a compliance between the tractions on a patch and its movement. What it does is known
to first order however soft it is, from the tangent (`bcid.forms.set_tangent`); the sensitivity to a compliance from none holds for
stiff ones only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.comparison.priors import log_variants
from bcid.comparison.state import State
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Term

Array = NDArray[np.float64]
Anchored = frozenset[str]
# Stiffnesses that are looked at, in notable ones, all equally likely.
_SIZES = np.geomspace(0.04, 2.0, 4)


@dataclass(frozen=True)
class Yielding:
    """A set of anchors, some or all of which give.

    Attributes:
        anchors: the set.
        term: the effect with its place and stiffness.
        moved: scaled movement of the values against the set that was followed, shape (n,).
        chi2: of the residual then.
        gain: logarithm of how much likelier it makes the data than that set, its places and stiffnesses being equally likely.
    """

    anchors: Anchored
    term: Term
    moved: Array
    chi2: float
    gain: float


def gives(effect: Effect) -> bool:
    """Whether an effect holds anchored patches by springs instead."""
    return effect.frees and len(effect.parameters) == 1 and effect.parameters[0].reciprocal


def yielding(state: State, effect: Effect, whole: Sequence[Anchored], parts: Sequence[Anchored]) -> list[Yielding]:
    """Sets that give, the best fitting first; collective.

    Args:
        state: the set that was followed.
        effect: see `gives`.
        whole: sets that give as a whole.
        parts: sets of which single patches give.
    """
    parameter, predictor = effect.parameters[0], state.predictor
    cases = []
    for anchors, places in [*((s, [""]) for s in whole), *((s, sorted(s)) for s in parts)]:
        for place in places if anchors else []:
            cases += [
                (anchors, Term(effect, {parameter.name: float(s * parameter.scale)}, place=place)) for s in _SIZES
            ]
    soft = [
        dict.fromkeys([term.place] if term.place else anchors, 1 / term.values[parameter.name])
        for anchors, term in cases
    ]
    moves = predictor.moves(state.model, state.anchors, state.prediction, [anchors for anchors, _ in cases], soft)
    columns = state.errors.whiten(np.column_stack([predictor.data.vector(moved) for moved in moves]))
    squares = np.sum((state.scaled[:, None] - columns) ** 2, axis=0)
    found = []
    for (anchors, term), column, chi2 in zip(cases, columns.T, squares, strict=True):
        gain = (state.chi2 - float(chi2)) / 2 + log_variants(len(_SIZES) * (1 + len(anchors)))
        found.append(Yielding(anchors, term, column, float(chi2), gain))
    return sorted(found, key=lambda one: (one.chi2, len(one.anchors), sorted(one.anchors), one.term.place))
