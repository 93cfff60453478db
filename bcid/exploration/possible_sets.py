"""The anchor sets that pulls leave possible, and what they predict for these pulls."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.comparison.fitted_hypothesis import FittedHypothesis
from bcid.comparison.set_tangents import neighbours, sets_predicted
from bcid.forms.model import Model
from bcid.inference.discrepancy import Evidence
from bcid.inference.hypotheses import HypothesisOdds
from bcid.measurement import Action
from bcid.predict.pull_predictor import PullPredictor
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
Anchored = frozenset[str]


@dataclass(frozen=True)
class PossibleSets:
    """What sets predict for all pulls, for `bcid.comparison.full_search`.

    Attributes:
        working: predicts pulls.
        actions: of all pulls.
        rows: of the measurement: fiducials, and the gripper where its force is measured.
    """

    working: PullPredictor
    actions: tuple[Action, ...]
    rows: int

    def evidences(
        self, rival: FittedHypothesis, begun: Model, excluded: frozenset[Anchored]
    ) -> dict[Anchored, Evidence]:
        """See `bcid.comparison.full_search.SetEvaluator`."""
        state = rival.judged
        sets = [anchors for anchors in neighbours(state, begun, True) if anchors not in excluded]
        predicted = self._predicted(sets, state.model)
        return sets_predicted(state, begun, predicted, rival.jacobian(state.errors))

    @property
    def failed(self) -> Collection[Anchored]:
        """None is known: a set that cannot be followed in a pull may be so in others."""
        return ()

    def _predicted(self, sets: Sequence[Anchored], model: Model) -> dict[Anchored, Array]:
        """Where the markers go in all pulls, each (frames, rows, 3), m, of the sets that can be followed; collective."""
        tasks = [(anchors, action) for anchors in sets for action in self.actions]
        own = model.constants() == self.working.model.constants()
        found = iter(self.working.predict(tasks, models=None if own else [model] * len(tasks)))
        whole = {s: np.concatenate([next(found).positions[:, : self.rows] for _ in self.actions]) for s in sets}
        return {anchors: positions for anchors, positions in whole.items() if np.isfinite(positions).all()}


def negligible(odds: HypothesisOdds) -> frozenset[Anchored]:
    """The least probable sets, which hold no more than a negligible probability together.

    By Markov's inequality they would come to hold 5 % with no more than 20 times that.
    """
    shares: dict[Anchored, float] = {}
    for h, p in odds.probabilities.items():
        shares[h.anchors] = shares.get(h.anchors, 0.0) + p
    order = sorted(shares, key=lambda s: (shares[s], -len(s), sorted(s)))
    count = int(np.searchsorted(np.cumsum([shares[s] for s in order]), SETTINGS.counting))
    return frozenset(order[:count])
