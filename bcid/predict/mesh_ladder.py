"""What the fine level says of the error of the working one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.forms.model import Model
from bcid.inference.knots import Knots
from bcid.inference.mesh_error import MeshError, gains
from bcid.measurement import Action
from bcid.predict.kept_predictions import MeasurementPrediction
from bcid.predict.predictor import Predictor

Array = NDArray[np.float64]
# A distance of positions need not be known as well as they themselves; and that the states are stable the working level has shown.
_FINE_RTOL = 3e-5
# Between steps in which the fine level is followed its distance is known to no less than this part of the noise.
_BENT = 0.2


def mesh_error(
    predictor: Predictor, model: Model, anchors: Iterable[str], prediction: MeasurementPrediction
) -> MeshError:
    """Of a prediction on the working level; collective."""
    finer = predictor.finer
    fine = None if finer is None else _finer_positions(predictor, model, anchors, prediction, finer)
    if finer is None or fine is None or prediction.failure:
        return MeshError.unknown(predictor.data.mask.shape)
    refinement = (predictor.unknowns(finer) / predictor.unknowns(predictor.level)) ** (1 / 3)
    by = gains(refinement, predictor.scene.levels[finer].degree, predictor.data.kinds)
    error = MeshError.between(prediction.positions, fine, by)
    return replace(error, about=(model.name, frozenset(anchors)), fiducials=len(predictor.scene.fiducials))


def _finer_positions(
    predictor: Predictor, model: Model, anchors: Iterable[str], prediction: MeasurementPrediction, level: int
) -> Array | None:
    """Positions on another level, whose distance from those of the working one is smooth along an action; None if not known.

    It is followed in a few steps, between which that distance is interpolated; in all where those are too large for it or the
    distance is too bent, and where a model remembers them or something happens in one of them.
    """
    if not (predictor.thin or model.remembers or model.jumps):
        ends = zip(predictor.actions, predictor.last_seen(), strict=True)
        known = [Knots.of(action, 0, last, timed=not model.steady) for action, last in ends]
        few, frames = predictor.in_steps(
            [k.steps for k in known], replace(predictor.settings, rtol=_FINE_RTOL, pivots=False)
        )
        second = few.predict(model, anchors, level, keep=True, near=states_in(prediction, frames))
        if not second.failure:
            apart = np.full(prediction.positions.shape, np.nan)
            apart[frames] = second.positions - prediction.positions[frames]
            data = predictor.data
            noise = data.noise(data.vector(data.about - prediction.positions))
            # One number for positions, forces and torques each: of a marker that is not seen no noise is known.
            kinds = {kind: float(np.sqrt(np.mean(noise[data.kind == kind] ** 2))) for kind in np.unique(data.kind)}
            units = np.array([kinds.get(kind, 1.0) for kind in data.kinds])[:, None]
            apart /= units
            # Of forces or torques none of which was measured the distance is not asked for.
            apart[:, ~np.isin(data.kinds, list(kinds))] = 0.0
            bent = max(k.fill(apart) for k in known)
            if bent < _BENT:
                return np.asarray(prediction.positions + apart * units)
    near = states_in(prediction, np.arange(len(prediction.positions)))
    second = predictor.predict(model, anchors, level, keep=True, near=near)
    distance = carried_on(second.positions - prediction.positions, predictor.actions)
    return None if distance is None else prediction.positions + distance


def carried_on(apart: Array, actions: Iterable[Action]) -> Array | None:
    """Distances (frames, rows, 3), m, that end before their action does, as they were last; None where of one only rest is."""
    found = apart.copy()
    for action in actions:
        came = np.flatnonzero(np.isfinite(apart[action.frames]).all(axis=(1, 2)))
        if not len(came) or (came[-1] == 0 and len(action) > 1):
            return None
        found[action.frames[came[-1] + 1 :]] = apart[action.frames[came[-1]]]
    return found


def states_in(prediction: MeasurementPrediction, frames: NDArray[np.int64]) -> dict[int, Array]:
    """The states that this rank has of some frames, by their numbers among these."""
    states = {frame: state for part in prediction.parts.values() for frame, state in (part.states or {}).items()}
    return {k: states[int(frame)] for k, frame in enumerate(frames) if int(frame) in states}
