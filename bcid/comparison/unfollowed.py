"""Sets that cannot be followed to the end: that a solve fails says nothing against them."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from bcid.base.errors import SolveError
from bcid.comparison.fit import Fit
from bcid.comparison.fitted_hypothesis import FittedHypothesis
from bcid.comparison.loosened import slackens
from bcid.comparison.state import State
from bcid.forms.model import Model
from bcid.inference.hypotheses import Hypothesis, log_prior
from bcid.inference.mesh_error import MeshError

# Springs so many times as soft as the fitted ones hold nothing where those hardly do.
_SOFTER = 100.0


def check_not_stood_for(best: FittedHypothesis, refused: Collection[Hypothesis], begun: Model) -> None:
    """A patch that gives does not stand for a set without it that cannot be followed; collective.

    Held as softly as if it were not held it shows what that set does, in all steps: it is likelier than the answer where the answer
    is nothing else.

    Args:
        best: the answer.
        refused: hypotheses that cannot be followed to the end.
        begun: the model without added effects.

    Raises:
        ContinuationError: it stands for one, so that what this cannot be followed in is not to be compared.
    """
    state = best.fitted.state
    for term in state.model.terms:
        others = "+".join(name for name in best.names if name != term.effect.name)
        without = state.anchors - {term.place}
        if not (slackens(term.effect) and term.place and Hypothesis(without, others) in refused):
            continue
        (stiffness,) = term.values
        soft = term.with_values({stiffness: term.values[stiffness] / _SOFTER})
        model = state.model.without(term.label)
        if _log_without(best, model + soft, begun) > best.log:
            # Followed again, it says how far it can be compared.
            State.of(state.predictor, model, without, MeshError.unknown(state.predictor.data.mask.shape))


def _log_without(best: FittedHypothesis, model: Model, begun: Model) -> float:
    """Logarithm of evidence and prior of a model with other numbers than those of the answer, one effect counting as none."""
    state, count = best.fitted.state, len(best.names) - 1
    try:
        there = State.of(state.predictor, model, state.anchors, best.judged.errors.mesh)
    except SolveError:
        return -math.inf
    found = FittedHypothesis.of(Fit.at(there), begun, best.known).evidence
    plain, forced = (log_prior(count, unknown, best.known) for unknown in (False, True))
    return float(np.logaddexp(found.plain + plain, found.forced + forced))
