"""Predictions of a measurement, of which the latest are kept: to be asked for again, and to begin others at their states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from bcid.forms.forward import Prediction
from bcid.forms.model import Model

Array = NDArray[np.float64]
# A prediction in a few steps begins at the states of another one that differs by so many patches.
_NEAR = 2
# So many are kept: what only changes the picture needs no other; of a few steps, many more.
_KEPT, _KEPT_THIN = 5, 64
T = TypeVar("T")
# So many are kept: of some ten sets in each of some ten pulls, on two levels, with their sensitivities.
_KEPT = 512


@dataclass(frozen=True)
class MeasurementPrediction:
    """Prediction of a model: positions the same on every rank, states where they were computed.

    Attributes:
        positions: shape (frames, fiducials, 3), m; NaN in frames that could not be reached.
        parts: this rank's own predictions, by action.
        failure: why it could not be followed to the end, or "".
    """

    positions: Array
    parts: dict[str, Prediction]
    failure: str = ""


class PredictionKey(NamedTuple):
    """What a prediction depends on: the level, the parts of the model that move the body, the anchors, and names of actions."""

    level: int
    model: Model
    anchors: frozenset[str]
    actions: tuple[str, ...]


class KeptPredictions:
    """The latest predictions.

    Args:
        thin: whether they are of a few steps of each action only.
    """

    def __init__(self, thin: bool) -> None:
        self.thin = thin
        self._known: list[tuple[PredictionKey, bool, MeasurementPrediction]] = []

    def of(self, key: PredictionKey, keep: bool) -> MeasurementPrediction | None:
        """The one of a key, if it is known; `keep`: with its states."""
        return next((prediction for k, kept, prediction in self._known if k == key and kept >= keep), None)

    def add(self, key: PredictionKey, keep: bool, prediction: MeasurementPrediction) -> None:
        """Keep one, and forget the oldest."""
        self._known = [*self._known[-(_KEPT_THIN if self.thin else _KEPT) :], (key, keep, prediction)]

    def near(self, key: PredictionKey) -> dict[str, Mapping[int, Array]]:
        """States to start from, by action: of the latest prediction of the same model with other numbers.

        Where steps are large also of one with other anchors; small steps extrapolate as well.
        """
        best = _NEAR if self.thin else 0
        found: dict[str, Mapping[int, Array]] = {}
        for other, kept, prediction in reversed(self._known):
            apart = len(other.anchors ^ key.anchors)
            if kept and other.level == key.level and other.model.name == key.model.name and apart <= best:
                best, found = apart - 1, {name: part.states for name, part in prediction.parts.items() if part.states}
        return found


class KeptActions:
    """Results of the latest actions on this process."""

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}

    def result(self, question: str, work: Callable[[], T]) -> T:
        """What `work` gives, or gave when the same was asked before."""
        if question not in self._known:
            found = work()
            while len(self._known) >= _KEPT:
                del self._known[next(iter(self._known))]
            self._known[question] = found
        known: T = self._known[question]
        return known
