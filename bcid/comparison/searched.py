"""A search over hypotheses from its beginning to an answer about frames that speak for or against a model."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bcid.comparison.buckled_frames import leave_out
from bcid.comparison.first_sets import first_sets
from bcid.comparison.first_state import first_state, settled_state
from bcid.comparison.full_search import FullSearch
from bcid.comparison.state import State
from bcid.forms.model import Model
from bcid.predict.predictor import Predictor

Anchored = frozenset[str]


def searched(
    predictor: Predictor,
    model: Model,
    likely: Sequence[Anchored],
    search: Callable[[State, Sequence[Anchored]], FullSearch],
) -> FullSearch:
    """The search that has run; collective.

    A few steps may take a body that buckles for another one. Where something is missing beside the likeliest set, and the body
    buckles with it, what was seen from there on is left out and the search is begun anew.

    Args:
        predictor: of the measurement.
        model: without added effects.
        likely: sets to take for the likely ones, where an earlier search knows them.
        search: makes the search from the model with a likely set and all likely sets.

    Raises:
        ContinuationError: no anchor set can be followed to the end with the model.
    """
    base, sets = first_state(predictor, model, likely)
    asked = {base.anchors}
    while True:
        found = search(base, sets)
        best = found.run().odds.best
        if best.anchors in asked or not (best.names or best.unknown):
            return found
        asked.add(best.anchors)
        if not leave_out(predictor, model, best.anchors):
            return found
        sets = first_sets(predictor, model)
        base = settled_state(predictor, model, sets[0])
