"""A hypothesis about what is held and what acts, with its agreement with the data."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import overlaid
from bcid.base.errors import SolveError, evaluating
from bcid.forms.force_bumps import force_unit
from bcid.forms.forward import Prediction
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.change_point import ChangePointForce
from bcid.inference.continuation import ContinuationError
from bcid.inference.discrepancy import Evidence, SmoothDiscrepancy
from bcid.inference.error_covariance import ErrorCovariance, NuisanceEstimate
from bcid.inference.evidence import LinearParameters, LowRankDiscrepancy
from bcid.inference.mesh_error import MeshError
from bcid.inference.nuisances import NuisanceModes, fitted_instead, placed, replaced, stood_for
from bcid.predict.kept_predictions import MeasurementPrediction
from bcid.predict.mesh_ladder import mesh_error
from bcid.predict.predictor import Predictor
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
# A set with which steps must be halved more often is seldom the true one.
FEW_STEPS = Settings(rtol=1e-6, halvings=2)


@dataclass(frozen=True)
class State:
    """A model with an anchor set, predicted and compared.

    Attributes:
        model, anchors: the hypothesis.
        prediction: its prediction on the working level, with states.
        errors: covariance of the residual.
        unknown: what something unknown and smooth does to the values.
        spots: the same of a force at each of many spots, shape (n, spots, 3), m.
        free: numbers of the model, by full name, that were fitted to the data.
        modes: what all nuisances do, those in whose place effects of the model act included; None where these are of `errors`.
    """

    predictor: Predictor
    model: Model
    anchors: frozenset[str]
    prediction: MeasurementPrediction
    errors: ErrorCovariance
    unknown: SmoothDiscrepancy
    spots: Array
    free: tuple[str, ...] = ()
    modes: NuisanceModes | None = None

    @classmethod
    def of(
        cls,
        predictor: Predictor,
        model: Model,
        anchors: frozenset[str],
        mesh: MeshError | None = None,
        free: tuple[str, ...] = (),
        prediction: MeasurementPrediction | None = None,
        nuisances: NuisanceModes | None = None,
    ) -> State:
        """Predict and compare; collective. Without `mesh` the ladder is asked for its error.

        What the scene may have slightly wrong is about the same with other anchors or small effects: `nuisances` of another state
        may be taken.

        Raises:
            ContinuationError: the model cannot be followed to the end; `SolveError` where only some steps are.
        """
        prediction = prediction or predictor.predict(model, anchors, keep=True)
        if prediction.failure:
            who = f"{model.name} with {' '.join(sorted(anchors)) or 'no anchor'}"
            message = f"{who}: {prediction.failure}"
            if predictor.thin:
                raise SolveError(message)
            came = np.asarray(np.isfinite(prediction.positions).all(axis=(1, 2)))
            raise ContinuationError(message, f"{who} cannot be followed", came)
        mesh = mesh_error(predictor, model, anchors, prediction) if mesh is None else mesh
        residual = predictor.data.values - predictor.data.vector(prediction.positions + mesh.correction)
        modes, unknown, spots = predictor.disturbances(model, anchors, prediction, nuisances)
        errors = ErrorCovariance(predictor.data, predictor.data.noise(residual), mesh, modes)
        errors = _beside(errors, model, free)
        return cls(predictor, model, anchors, prediction, errors, unknown, spots, free, modes)

    def thinned(self, steps: int, settings: Settings) -> State:
        """The same hypothesis in a few steps of each action, see `Predictor.thinned`."""
        predictor, frames = self.predictor.thinned(steps, settings)
        return State.of(predictor, self.model, self.anchors, self.errors.mesh.at(frames), self.free)

    def of_set(self, anchors: frozenset[str], model: Model | None = None) -> State:
        """The same with other anchors, or another model, and what is slightly wrong as here; collective.

        Raises:
            SolveError: as `of`.
        """
        model = model or self.model
        return State.of(self.predictor, model, anchors, self.errors.mesh, self.free, nuisances=self.whole_modes)

    def with_own_errors(self, anew: bool = False) -> State:
        """The same with the error of the mesh, and what is slightly wrong, as they are with these anchors; collective.

        With `anew` also where they are those of these anchors, but of other numbers.
        """
        mesh = self.errors.mesh
        if mesh.about[1] == self.anchors and not anew:
            return self
        found = mesh_error(self.predictor, self.model, self.anchors, self.prediction) if mesh.known else mesh
        mesh = found if found.known else replace(mesh, about=(mesh.about[0], self.anchors))
        return State.of(self.predictor, self.model, self.anchors, mesh, self.free, self.prediction)

    def with_errors(self, mesh: MeshError, nuisances: NuisanceModes | None = None) -> State:
        """The same with another error of the mesh, and what else is slightly wrong."""
        modes = nuisances or self.whole_modes
        errors = ErrorCovariance(self.predictor.data, self.errors.sigma, mesh, modes)
        return replace(self, errors=_beside(errors, self.model, self.free), modes=modes)

    @property
    def whole_modes(self) -> NuisanceModes:
        """What all nuisances do, whatever the model has in their place."""
        return self.errors.nuisances if self.modes is None else self.modes

    @property
    def replaced(self) -> Array:
        """What the nuisances do in whose place effects of the model act, shape (n, k), m."""
        return replaced(self.whole_modes, self.predictor.data, self.model)

    def room(self, within: str) -> tuple[float, float]:
        """Where a number can be that lies within the body, see `bcid.forms.parameter.Shape`, m."""
        points = self.predictor.forward(self.model).mesh.points
        low, high = points.min(axis=0), points.max(axis=0)
        if within == "size":
            return 0.0, float(np.linalg.norm(high - low)) / 2
        axis = "xyz".index(within)
        return float(low[axis]), float(high[axis])

    @property
    def predicted(self) -> Array:
        """Positions as the model has them with the error of the mesh taken out, shape (frames, fiducials, 3), m."""
        return np.asarray(self.prediction.positions + self.errors.mesh.correction)

    @cached_property
    def residual(self) -> Array:
        """Measured minus predicted, shape (n,), m."""
        return np.asarray(self.predictor.data.values - self.predictor.data.vector(self.predicted))

    @cached_property
    def scaled(self) -> Array:
        """The residual in units of its errors, shape (n,)."""
        return self.errors.whiten(self.residual)

    @cached_property
    def chi2(self) -> float:
        """Sum of its squares."""
        scaled = self.scaled
        return float(scaled @ scaled)

    @property
    def allowance(self) -> float:
        """What a hypothesis pays for the errors that it allows for besides the noise, in units of chi-square."""
        return 2 * (self.errors.log_volume - float(np.sum(np.log(self.errors.sigma))))

    def evidence(self, numbers: LinearParameters | None = None) -> Evidence:
        """How likely the data are, with and without an unknown force; `numbers` are what was unknown of the model."""
        return Evidence.of(self.errors, self.residual, self.forces, numbers, self.sudden)

    @cached_property
    def forces(self) -> list[LowRankDiscrepancy]:
        """An unknown force of each kind, in units of the errors."""
        return self.unknown.forces(self.errors, force_unit(self.predictor.forward(self.model)))

    @cached_property
    def sudden(self) -> ChangePointForce | None:
        """An unknown force that begins at a spot; None in a few steps, of which hardly any shows what was before."""
        return None if self.predictor.thin else ChangePointForce(self.errors, self.spots)

    @property
    def rms(self) -> float:
        """RMS residual per coordinate of a position, m."""
        return self.predictor.data.rms(self.residual)

    @property
    def rough(self) -> float:
        """RMS per coordinate of what is left once mesh, frame and nuisances are allowed for, m."""
        return self.predictor.data.rms(self.errors.rough(self.residual))

    @property
    def rough_values(self) -> Array:
        """The part of the residual that is most likely noise whatever is missing: an unknown force is allowed for too, (n,), m."""
        return self._beside_unknown(self.evidence()).rough(self.residual)

    @property
    def likeliest_errors(self) -> ErrorCovariance:
        """The errors, with an unknown force or misfit where that makes the measurement likelier."""
        evidence = self.evidence()
        return self._beside_unknown(evidence) if evidence.forced > evidence.plain else self.errors

    def _beside_unknown(self, evidence: Evidence) -> ErrorCovariance:
        """The errors with something unknown besides, as it is likeliest."""
        errors, data = self.errors, self.predictor.data
        unknown = self.unknown.likeliest(data, evidence)
        return ErrorCovariance(data, errors.sigma, errors.mesh, errors.nuisances.beside(unknown))

    @cached_property
    def told(self) -> list[NuisanceEstimate]:
        """What the data say of each thing that the scene may have slightly wrong."""
        return self.errors.told(self.residual)

    @property
    def noise(self) -> float:
        """RMS of the noise of positions, m."""
        return self.predictor.data.rms(self.errors.sigma)


def _beside(errors: ErrorCovariance, model: Model, free: tuple[str, ...]) -> ErrorCovariance:
    """Errors without what a model says in their place."""
    return errors.without(stood_for(model) | fitted_instead(model, free), placed(model))


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


def few_steps(predictor: Predictor) -> int:
    """How many steps of each action are compared first: of few markers more."""
    data = predictor.data
    seen = len(data) / max(len(np.unique(data.frame)), 1)
    return max(SETTINGS.steps, math.ceil(SETTINGS.values / max(seen * len(predictor.actions), 1)))


def in_few_steps(state: State) -> State:
    """The same hypothesis on a few steps of each action, or as it is where it needs smaller ones; collective."""
    try:
        return state.thinned(few_steps(state.predictor), FEW_STEPS)
    except SolveError:
        return state
