"""Evidence of many anchor sets from the tangent of one of them, without another solve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.forms.model import Model
from bcid.inference.discrepancy import Evidence
from bcid.inference.evidence import LinearParameters
from bcid.inference.priors import PRIORS
from bcid.search.fitting.parameter_priors import of_state
from bcid.search.fitting.state import State
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
Anchored = frozenset[str]


def neighbours(state: State, begun: Model, every: bool) -> list[Anchored]:
    """Sets on which the added effects of a state can act: all of few patches if wanted, else those that differ by two or three."""
    count, few = len(state.predictor.scene.patches), len(state.predictor.scene.patches) <= SETTINGS.few_patches
    return _acting_on(state, begun, count if every and few else 3 if few else 2)


def every_set(state: State, begun: Model) -> list[Anchored]:
    """All sets on which the added effects of a state can act."""
    return _acting_on(state, begun, len(state.predictor.scene.patches))


def _acting_on(state: State, begun: Model, most: int) -> list[Anchored]:
    """Sets that differ from that of a state by so many patches at most, and on which its added effects can act.

    Without anchors a body that is gripped in no action, or not in all, has no equilibrium unless something else holds it.
    """
    patches = list(state.predictor.scene.patches)
    found = [state.anchors ^ frozenset(s) for count in range(most + 1) for s in combinations(patches, count)]
    added, scene = state.model.added(begun), state.predictor.scene
    places = [(term.place, term.effect.places) for term in added if term.effect.places]
    gripped = all(action.grasp for action in state.predictor.actions)
    other = state.model.rollers or any(term.effect.acts_on and term.effect.potential for term in state.model.terms)
    # That a state has an equilibrium without anchors shows that it needs none.
    held = gripped or other or not state.anchors
    return [s for s in found if (s or held) and all(place in acting(scene, s) for place, acting in places)]


def sets_about(state: State, begun: Model, jacobian: Array | None = None) -> dict[Anchored, Evidence]:
    """Evidence of the model of a state on other sets, and on its own, as its tangent shows them; collective.

    Args:
        state: the model, in a few steps or all.
        begun: the model without added effects.
        jacobian: change of the scaled residual with each fitted number, shape (n, p), where it is known.

    Returns:
        By set; nothing where the numbers are not visible, or the tangent cannot be computed.
    """
    numbers = of_state(state, begun, jacobian)
    if numbers is None:
        return {}
    sets = neighbours(state, begun, state.predictor.thin)
    try:
        moves = state.predictor.moves(state.model, state.anchors, state.prediction, sets)
    except SolveError:
        return {}
    return dict(zip(sets, _evidences(state, numbers, moves, PRIORS.tangent_error), strict=True))


def sets_predicted(
    state: State, begun: Model, predicted: Mapping[Anchored, Array], jacobian: Array | None = None
) -> dict[Anchored, Evidence]:
    """Evidence of other sets and of its own, as they are predicted with the numbers of a state, by its errors; collective.

    Arguments are as of `sets_about`; `predicted` are the positions with each set, (frames, rows, 3), m. Nothing where the own set
    is not among them.
    """
    numbers = of_state(state, begun, jacobian)
    if numbers is None or state.anchors not in predicted:
        return {}
    moves = [positions - predicted[state.anchors] for positions in predicted.values()]
    return dict(zip(predicted, _evidences(state, numbers, moves, (0.0, 0.0)), strict=True))


def _evidences(
    state: State, known: LinearParameters, moves: Sequence[Array], unsure: tuple[float, float]
) -> list[Evidence]:
    """Of sets that move the markers elsewhere by (frames, markers, 3), m, than the one of a state.

    How far they move them in each action is `unsure`, see `Priors.tangent_error`; and the `known` numbers of the model may be
    others then.
    """
    data = state.predictor.data
    shifts = np.column_stack([data.vector(moved) for moved in moves])
    inside = data.action[:, None] == np.arange(len(data.actions))
    pulled = (data.vector(state.predicted) - data.vector(np.broadcast_to(data.rest, data.mask.shape))) ** 2
    sizes = np.sqrt((inside.T @ shifts**2) / np.maximum(inside.T @ pulled, 1e-300)[:, None])
    parts = shifts[:, :, None] * inside[:, None, :]
    columns = state.errors.whiten(parts.reshape(len(data), -1)).reshape(parts.shape)
    nowhere, found, (small, large) = np.zeros(len(data.actions)), [], unsure
    apart, positive = np.concatenate([nowhere, known.apart]), np.concatenate([nowhere > 0, known.positive])
    for shift, own, size in zip(shifts.T, np.moveaxis(columns, 1, 0), sizes.T, strict=True):
        error = np.broadcast_to(small + large * np.minimum(size, 1.0) ** 2, (len(known.widths), len(size)))
        numbers = LinearParameters(np.hstack([own, known.columns]), apart, np.hstack([error, known.widths]), positive)
        found.append(Evidence.of(state.errors, state.residual - shift, state.forces, numbers))
    return found
