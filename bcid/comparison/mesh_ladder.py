"""What the fine level says of the error of the working one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.comparison.kept_predictions import MeasurementPrediction
from bcid.comparison.knots import Knots
from bcid.comparison.predictor import Predictor
from bcid.forms.model import Model
from bcid.inference.mesh_error import MeshError

Array = NDArray[np.float64]
# Elements twice as small leave a quarter of the error.
_ORDER = 2
_LEAST_GAIN = 0.5
# A distance of positions need not be known as well as they themselves.
_FINE_RTOL = 3e-5
# Between steps in which the fine level is followed its distance is bent by no more than this part of the noise.
_BENT = 0.5


def mesh_error(
    predictor: Predictor, model: Model, anchors: Iterable[str], prediction: MeasurementPrediction
) -> MeshError:
    """Of a prediction on the working level; collective."""
    finer = predictor.finer
    fine = None if finer is None else _finer_positions(predictor, model, anchors, prediction, finer)
    if finer is None or fine is None or prediction.failure:
        return MeshError.unknown(predictor.data.mask.shape)
    unknowns = predictor.unknowns(finer) / predictor.unknowns(predictor.level)
    gain = max(unknowns ** (_ORDER / 3) - 1, _LEAST_GAIN)
    return replace(MeshError.between(prediction.positions, fine, gain), about=(model.name, frozenset(anchors)))


def _finer_positions(
    predictor: Predictor, model: Model, anchors: Iterable[str], prediction: MeasurementPrediction, level: int
) -> Array | None:
    """Positions on another level, whose distance from those of the working one is smooth along an action; None where it fails.

    It is followed in a few steps, between which that distance is interpolated; in all where those are too large for it or the
    distance is too bent, and where a model remembers them.
    """
    if not (predictor.thin or model.remembers):
        ends = zip(predictor.actions, predictor.last_seen(), strict=True)
        known = [Knots.of(action, 0, last) for action, last in ends]
        few, frames = predictor.in_steps([k.steps for k in known], replace(predictor.settings, rtol=_FINE_RTOL))
        second = few.predict(model, anchors, level, keep=True)
        if not second.failure:
            apart = np.full(prediction.positions.shape, np.nan)
            apart[frames] = second.positions - prediction.positions[frames]
            bent = max(k.fill(apart) for k in known)
            data = predictor.data
            noise = data.noise(data.vector(data.about - prediction.positions))
            if bent < _BENT * float(np.sqrt(np.mean(noise**2))):
                return np.asarray(prediction.positions + apart)
    second = predictor.predict(model, anchors, level, keep=True)
    return None if second.failure else second.positions
