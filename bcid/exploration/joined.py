"""Pulls as one measurement: what is common to all of them, as where the markers sit, is then common in their errors too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from bcid.base.collective import Comm
from bcid.forms.gripper_force import ForceScale
from bcid.measurement import Measurement
from bcid.predict.kept_predictions import KeptActions
from bcid.predict.predictor import Predictor
from bcid.predict.store import PredictionStore
from bcid.scene import Scene


def joined(pulls: Sequence[Measurement], scene: Scene) -> Measurement:
    """Measurements of one action each as one measurement, its actions numbered from 1."""
    parts = []
    for number, pull in enumerate(pulls, start=1):
        sigma = pull.sigma(scene.noise_sigma)
        data = pull.data.assign_coords(action=("frame", [str(number)] * pull.data.sizes["frame"]))
        if sigma is not None:
            data["sigma"] = (data["position"].dims, np.broadcast_to(sigma, data["position"].shape))
        parts.append(data)
    whole = xr.concat(parts, dim="frame", join="outer")
    return replace(pulls[0], data=whole)


class JoinedPredictors:
    """Predictors of pulls as one measurement. They share meshes, forward models, and what pulls before gave.

    Args:
        scene: the scene.
        comm: an MPI communicator.
        level: fine level, see `Predictor`.
        store: keeps predictions.
    """

    def __init__(
        self, scene: Scene, comm: Comm, level: int | None = None, store: PredictionStore | None = None
    ) -> None:
        self.scene, self.comm, self.level, self.store = scene, comm, level, store
        self._first: Predictor | None = None

    def of(self, pulls: Sequence[Measurement]) -> Predictor:
        """The predictor of all pulls; collective."""
        whole = joined(pulls, self.scene)
        if self._first is None or self._first.forces != ForceScale.of(self.scene, whole):
            self.destroy()
            self._first = Predictor(self.scene, whole, self.comm, self.level, store=self.store)
            self._first.repeated = KeptActions()
        return self._first.repeating(whole)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._first is not None:
            self._first.destroy()
        self._first = None
