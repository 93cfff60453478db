"""Fields of a model that was compared with a measurement: displacement, strain energy, and the gripper's force."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from bcid.base.collective import overlaid
from bcid.base.errors import SolveError, evaluating
from bcid.comparison.state import State
from bcid.forms.forward import Prediction


def detailed(state: State) -> Prediction:
    """The prediction of a state on all ranks with `wrench`, `displacement` and `energy`, NaN in frames without; collective.

    The positions are those that the mesh has: what it leaves is not taken out.
    """
    predictor = state.predictor
    forward, frames = predictor.forward(state.model), len(predictor.data.mask)
    wrench, displacement = np.full((frames, 6), np.nan), np.full((frames, len(forward.mesh.points), 3), np.nan)
    energy = displacement[..., 0].copy()
    for action in predictor.actions:
        part = state.prediction.parts.get(action.name)
        if part is not None and part.states is not None:
            with suppress(SolveError), evaluating("fields of the answer", predictor.skip):
                found = forward.detail(state.anchors, [action], part)
                for whole, own in ((wrench, found.wrench), (displacement, found.displacement), (energy, found.energy)):
                    assert own is not None
                    whole[action.frames] = own[action.frames]
    wrench, displacement, energy = (overlaid(predictor.comm.allgather(a)) for a in (wrench, displacement, energy))
    return Prediction(state.prediction.positions, (), None, wrench, displacement, energy)
