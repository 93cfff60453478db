"""What hypotheses predict for pulls to come, with what is not known of their numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.exploration.fitted_numbers import FittedNumbers
from bcid.inference.data import Data
from bcid.inference.hypotheses import Hypothesis
from bcid.inference.nuisances import NuisanceModes
from bcid.measurement import Action
from bcid.predict.pull_prediction import PullPrediction
from bcid.predict.pull_predictor import PullPredictor, small_action

Array = NDArray[np.float64]
Fitted = Mapping[Hypothesis, FittedNumbers]


@dataclass(frozen=True)
class HypothesisPredictor:
    """Predicts pulls with hypotheses: sets alone, or with the numbers that were `fitted`; methods are collective.

    Attributes:
        working: of the working level.
        fine: of a finer level; None if there is none.
    """

    working: PullPredictor
    fine: PullPredictor | None = None

    def predict(
        self, hypotheses: Sequence[Hypothesis], fitted: Fitted, action: Action, detailed: bool
    ) -> list[PullPrediction]:
        """What hypotheses predict for an action on the working level, `detailed` with force, strain and eigenvalue."""
        plain = [h for h in hypotheses if h not in fitted]
        found = dict(zip(plain, self.working.predict([(h.anchors, action) for h in plain], detailed), strict=True))
        acting = [h for h in hypotheses if h in fitted]
        if acting:
            found |= dict(zip(acting, self._loosely(acting, fitted, action, detailed), strict=True))
        return [found[h] for h in hypotheses]

    def predict_finely(
        self, hypotheses: Sequence[Hypothesis], fitted: Fitted, action: Action, detailed: bool
    ) -> list[PullPrediction]:
        """The same on the fine level, without what is not known of the numbers."""
        assert self.fine is not None
        models = [fitted[h].model if h in fitted else self.fine.model for h in hypotheses]
        return self.fine.predict([(h.anchors, action) for h in hypotheses], detailed, models)

    def small_steps(
        self, hypotheses: Sequence[Hypothesis], fitted: Fitted, grasp: str, size: float
    ) -> list[PullPrediction]:
        """What hypotheses predict for a step of `size` (m) along each axis, as `predict` for `small_action`."""
        plain = [h for h in hypotheses if h not in fitted]
        acting = [h for h in hypotheses if h in fitted]
        steps = self.working.small_steps([h.anchors for h in plain], grasp, size)
        found = dict(zip(plain, steps, strict=True))
        if acting:
            steps = self.predict(acting, fitted, small_action(grasp, size), detailed=False)
            found |= dict(zip(acting, steps, strict=True))
        return [found[h] for h in hypotheses]

    def modes(self, best: Hypothesis, action: Action, data: Data, predicted: Array) -> NuisanceModes | None:
        """What the scene may have slightly wrong does to the values of a pull to come, as the tangent of a set tells.

        The set predicts (frames, rows, 3), m. None where it cannot be followed.
        """
        (tangent,) = self.working.differentiate([(best.anchors, action)])
        if tangent is None:
            return None
        return self.working.nuisances.modes(data, tangent.found, tangent.wanted, self.working.model, predicted)

    def _loosely(
        self, hypotheses: Sequence[Hypothesis], fitted: Fitted, action: Action, detailed: bool
    ) -> list[PullPrediction]:
        """What fitted hypotheses predict, and how that changes with their numbers."""
        numbers = [fitted[h] for h in hypotheses]
        tasks = [(h.anchors, action) for h in hypotheses]
        main = self.working.predict(tasks, detailed, [f.model for f in numbers])
        around = [(task, model) for task, f in zip(tasks, numbers, strict=True) for model in f.deviating]
        moved = iter(self.working.predict([task for task, _ in around], False, [model for _, model in around]))
        return [
            replace(one, loose=tuple(next(moved).positions - one.positions for _ in f.deviating))
            for one, f in zip(main, numbers, strict=True)
        ]
