"""What is believed of the numbers of an effect before the data are looked at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.forms.model import Model, Term
from bcid.inference.evidence import LinearParameters
from bcid.inference.priors import PRIORS, spaced
from bcid.inference.thresholds import THRESHOLDS
from bcid.search.fitting.fit import Coordinate, columns, coordinates
from bcid.search.fitting.state import State

Array = NDArray[np.float64]


def visible(shown: float) -> Array:
    """Sizes of the amounts of an effect that these data could show, in notable ones; none where they could show none.

    An amount that cannot be seen is told as nothing. A notable amount moves the data by `shown` standard deviations.
    """
    sizes = spaced(PRIORS.amounts)
    return sizes[sizes * shown >= THRESHOLDS.detection]


def log_share(count: int) -> float:
    """Logarithm of the probability of being visible, where so many of the sizes are."""
    return math.log(count / PRIORS.amounts[2])


def of_state(state: State, begun: Model, jacobian: Array | None = None) -> LinearParameters | None:
    """Numbers of a model that were fitted; None where these data could not show the amounts. Collective.

    Args:
        state: the model with these numbers.
        begun: the model that has none of them.
        jacobian: change of the scaled residual with each number, shape (n, p), where it is known.
    """
    if not state.free:
        return replace(LinearParameters.none(len(state.predictor.data)), log_prior=log_ways(state, begun))
    chosen, numbers = coordinates(state.model, state.free), state.model.constants()
    if jacobian is None:
        found = columns(state.predictor, state.model, state.anchors, state.prediction, chosen)
        moved = state.errors.whiten(found)
    else:
        moved = -jacobian
    amount = np.array([c.parameter.neutral is not None for c in chosen], dtype=bool)
    scale = np.array([c.scale for c in chosen])
    share = 0.0
    sizes: Array = np.ones(1)
    apart = np.array([_apart(c, numbers[c.name], begun) for c in chosen])
    if amount.any():
        shown = _from_nothing(moved * scale, apart / scale, amount, state, begun)
        moved = shown / scale
        sizes = visible(_least_shown(shown, amount, state, begun))
        if not len(sizes):
            return None
        share = log_share(len(sizes))
    widths = np.array([_width(c, numbers[c.name], state) for c in chosen])
    table = np.where(amount, sizes[:, None] * scale, widths)
    return LinearParameters(moved, apart, table, one_sided(chosen), share + log_ways(state, begun))


def _from_nothing(moved: Array, apart: Array, amount: NDArray[np.bool_], state: State, begun: Model) -> Array:
    """What notable amounts do, (n, p), where a further one shows nothing: what all of the effect does by its amount.

    As of a clock that is later than the gripper moves. Of what does the same from some amount on the tangent knows nothing of
    the way there, and that amount would be as likely as if it had been expected. By the change of least norm with which the
    amounts that are there, `apart`, (p,), do what they do (Broyden, Math. Comp. 19, 1965).
    """
    found = moved.copy()
    for term, own in _own_amounts(amount, state, begun):
        size, far = math.sqrt(float(np.mean(np.sum(moved[:, own] ** 2, axis=0)))), apart[own]
        if not len(visible(size)) and np.abs(far).max() > 1 and (done := _done(state, term)) is not None:
            found[:, own] += np.outer(done - moved[:, own] @ far, far) / (far @ far)
    return found


def _least_shown(shown: Array, amount: NDArray[np.bool_], state: State, begun: Model) -> float:
    """By how many standard deviations notable amounts, (n, p), move the data, of the effect, or the law, that shows least."""
    squares, rest = np.sum(shown**2, axis=0), amount.copy()
    groups = [own for _, own in _own_amounts(amount, state, begun)]
    for own in groups:
        rest &= ~own
    return min(math.sqrt(float(np.mean(squares[own]))) for own in [*groups, rest] if own.any())


def _own_amounts(amount: NDArray[np.bool_], state: State, begun: Model) -> list[tuple[Term, NDArray[np.bool_]]]:
    """Each effect of a model that has fitted amounts, and which of the fitted numbers they are, (p,)."""
    found = []
    for term in state.model.added(begun):
        names = {term.full(p.name) for p in term.effect.parameters}
        own = np.array([name in names for name in state.free], dtype=bool) & amount
        if own.any():
            found.append((term, own))
    return found


def _done(state: State, term: Term) -> Array | None:
    """What an effect of a model does to the data, in standard deviations; None where it cannot be followed without it."""
    predictor = state.predictor
    plain = predictor.predict(state.model.without(term.label), state.anchors)
    if plain.failure:
        return None
    return state.errors.whiten(predictor.data.vector(state.prediction.positions - plain.positions))


def log_ways(state: State, begun: Model) -> float:
    """Of how the added effects act where that is no number of a fit: at a place, from a frame on, with a period or without."""
    found = 0.0
    for term in state.model.added(begun):
        effect = term.effect
        places = len(effect.places(state.predictor.scene, state.anchors)) if effect.places else 1
        frames = len(state.predictor.data.mask) if effect.sudden else 1
        periodic = 2 if any(p.off is not None for p in effect.parameters) else 1
        found += log_variants(places * frames * periodic)
    return found


def one_sided(chosen: Sequence[Coordinate]) -> NDArray[np.bool_]:
    """Which numbers are amounts that cannot be below their neutral value."""
    found = [p.neutral is not None and (p.reciprocal or p.lower == p.neutral) for p in (c.parameter for c in chosen)]
    return np.array(found, dtype=bool)


def log_variants(count: int) -> float:
    """Of one of so many ways in which an effect may act."""
    return -math.log(max(count, 1))


def _apart(c: Coordinate, value: float, begun: Model) -> float:
    """How far a coordinate is from what was expected."""
    neutral = begun.neutral(c.parameter)
    if neutral is None:
        return 0.0
    return c.of(value) - (0.0 if c.parameter.reciprocal else neutral)


def _width(c: Coordinate, value: float, state: State) -> float:
    """Standard deviation of a number that is no amount: uniform over where it can be, from where it was found."""
    p = c.parameter
    if p.prior is not None:
        return p.prior[1]
    if p.period is not None:
        return p.period / math.sqrt(12)
    if p.off is not None:
        # A period: uniform in the cycles per measurement over those that are tried.
        cycle = value**2 / float(np.max(state.predictor.times))
        return cycle * float(np.ptp(PRIORS.cycles)) / math.sqrt(12)
    if p.within:
        low, high = state.room(p.within)
        return (high - low) / math.sqrt(12)
    if p.unit == "m":
        points = state.predictor.forward(state.model).mesh.points
        return float(np.linalg.norm(np.ptp(points, axis=0))) / 6
    if len(p.scan) > 1 and min(p.scan) <= 0:
        # Uniform between its bounds: a logarithm needs positive values.
        return (p.upper - p.lower) / math.sqrt(12)
    if len(p.scan) > 1:
        # Uniform in its logarithm over the values that are tried.
        return value * math.log(max(p.scan) / min(p.scan) * PRIORS.scanned**2) / math.sqrt(12)
    return PRIORS.other * c.scale
