"""A hypothesis about what is held and what acts, with its agreement with the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.compare.data import Errors, MeshError
from bcid.compare.twin import Reply, Twin
from bcid.forms.model import Model
from bcid.forms.solve import Settings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """A model with an anchor set, predicted and compared.

    Attributes:
        model, anchors: the hypothesis.
        reply: its prediction on the working level, with states.
        errors: covariance of the residual.
        free: numbers of the model, by full name, that were fitted to the data.
    """

    twin: Twin
    model: Model
    anchors: frozenset[str]
    reply: Reply
    errors: Errors
    free: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        twin: Twin,
        model: Model,
        anchors: frozenset[str],
        mesh: MeshError | None = None,
        free: tuple[str, ...] = (),
        reply: Reply | None = None,
    ) -> State:
        """Predict and compare; collective. Without `mesh` the ladder is asked for its error.

        Raises:
            SolveError: the model cannot be followed to the end.
        """
        reply = reply or twin.predict(model, anchors, keep=True)
        if reply.failure:
            raise SolveError(f"{model.name} with {' '.join(sorted(anchors)) or 'no anchor'}: {reply.failure}")
        mesh = twin.mesh_error(model, anchors, reply) if mesh is None else mesh
        residual = twin.data.values - twin.data.vector(reply.positions + mesh.correction)
        return cls(twin, model, anchors, reply, Errors(twin.data, twin.data.noise(residual), mesh), free)

    def thinned(self, steps: int, settings: Settings) -> State:
        """The same hypothesis, looked at in a few steps of each action (see `Twin.thinned`); its twin is to be destroyed."""
        twin, frames = self.twin.thinned(steps, settings)
        return State.of(twin, self.model, self.anchors, self.errors.mesh.at(frames), self.free)

    @property
    def predicted(self) -> Array:
        """Positions as the model has them with the error of the mesh taken out, shape (frames, fiducials, 3), m."""
        return np.asarray(self.reply.positions + self.errors.mesh.correction)

    @property
    def residual(self) -> Array:
        """Measured minus predicted, shape (n,), m."""
        return np.asarray(self.twin.data.values - self.twin.data.vector(self.predicted))

    @property
    def scaled(self) -> Array:
        """The residual in units of its errors, shape (n,)."""
        return self.errors.whiten(self.residual)

    @property
    def chi2(self) -> float:
        """Sum of its squares."""
        scaled = self.scaled
        return float(scaled @ scaled)

    @property
    def rms(self) -> float:
        """RMS residual per coordinate, m."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def noise(self) -> float:
        """RMS of the noise, m."""
        return float(np.sqrt(np.mean(self.errors.sigma**2)))
