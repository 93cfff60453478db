"""How the results of a predictor's expensive steps are kept in a store, as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.forms.forward import Prediction
from bcid.forms.probes import Sensitivities
from bcid.forms.set_tangent import StepTangent
from bcid.measurement import Action
from bcid.predict.kept_predictions import MeasurementPrediction
from bcid.predict.pull_prediction import PullPrediction

Array = NDArray[np.float64]
Arrays = dict[str, Any]
_PARTS = tuple(f.name for f in fields(StepTangent))


@dataclass(frozen=True)
class PredictionFormat:
    """Of predictions of some actions.

    Attributes:
        mine: those that this rank computes, or has when it goes on.
        comm: the ranks.
    """

    mine: Sequence[Action]
    comm: Comm

    def arrays(self, result: MeasurementPrediction) -> tuple[Arrays, Any]:
        """Positions, and by action the states with their frames, of all ranks."""
        own = {name: part.states for name, part in result.parts.items() if part.states}
        arrays: Arrays = {"positions": result.positions}
        for name, states in (item for some in self.comm.gather(own) or () for item in some.items()):
            arrays |= {f"frames {name}": np.array(list(states)), f"states {name}": np.array(list(states.values()))}
        return arrays, result.failure

    def result(self, arrays: Arrays, notes: Any) -> MeasurementPrediction:
        """With the states of this rank's actions."""
        positions = arrays["positions"]
        parts = {action.name: _part(action, positions, arrays) for action in self.mine}
        return MeasurementPrediction(positions, parts, str(notes))


def _part(action: Action, positions: Array, arrays: Arrays) -> Prediction:
    """Of one action. How it went is told by the whole."""
    own = np.full((1 + int(action.frames.max()), *positions.shape[1:]), np.nan)
    own[action.frames] = positions[action.frames]
    frames = arrays.get(f"frames {action.name}")
    states = None if frames is None else dict(zip(frames.tolist(), arrays[f"states {action.name}"], strict=True))
    return Prediction(own, (), states)


@dataclass(frozen=True)
class SensitivitiesFormat:
    """Of sensitivities, which are the same on every rank.

    Attributes:
        count: of probes that were asked for.
    """

    count: int

    def arrays(self, result: Sensitivities) -> tuple[Arrays, Any]:
        """Each in the frames in which anything of it is known."""
        arrays: Arrays = {}
        for name, array in result.named.items():
            known = np.flatnonzero(~np.isnan(array.reshape(len(array), -1)).all(axis=1))
            arrays |= {f"frames {name}": known, name: array[known]}
        return arrays, len(next(iter(result.named.values()), ()))

    def result(self, arrays: Arrays, notes: Any) -> Sensitivities:
        """NaN in the other frames."""
        whole = {}
        for name in (name for name in arrays if not name.startswith("frames ")):
            found = arrays[name]
            whole[name] = np.full((int(notes), *found.shape[1:]), np.nan, found.dtype)
            whole[name][arrays[f"frames {name}"]] = found
        return Sensitivities.of_named(whole, self.count)


class TangentsFormat:
    """Of the tangents of steps, which are the same on every rank, by frame."""

    def arrays(self, result: dict[int, StepTangent]) -> tuple[Arrays, Any]:
        """Steps as the first axis of each array."""
        stacked = {name: np.array([getattr(step, name) for step in result.values()]) for name in _PARTS}
        return {"frames": np.array(list(result), dtype=np.int64)} | stacked, None

    def result(self, arrays: Arrays, notes: Any) -> dict[int, StepTangent]:
        """By frame."""
        rows: Iterable[Any] = zip(*(arrays[name] for name in _PARTS), strict=True)
        return {int(k): StepTangent(*row) for k, row in zip(arrays["frames"], rows, strict=True)}


class PullFormat:
    """Of the prediction of a pull, which is the same on every rank."""

    def arrays(self, result: PullPrediction) -> tuple[Arrays, Any]:
        """Positions, with force, strain and eigenvalue."""
        return {
            "positions": result.positions,
            "numbers": np.array([result.force, result.strain, result.eigenvalue]),
        }, None

    def result(self, arrays: Arrays, notes: Any) -> PullPrediction:
        """The same."""
        force, strain, eigenvalue = (float(number) for number in arrays["numbers"])
        return PullPrediction(arrays["positions"], force, strain, eigenvalue)
