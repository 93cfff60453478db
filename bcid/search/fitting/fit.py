"""Fitting numbers of a model: nonlinear least squares with the tangent as Jacobian."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from bcid.base.errors import InputError, SolveError, nearest
from bcid.base.tails import limit_beyond, normal_quantile
from bcid.base.units import UNTOLD, WIDE
from bcid.forms.model import Model
from bcid.forms.parameter import Parameter
from bcid.forms.probes import Probe, SensitivityRequest
from bcid.inference.nuisances import fitted_instead
from bcid.inference.priors import PRIORS
from bcid.inference.stiffness import Stiffness, StiffnessScale
from bcid.inference.thresholds import THRESHOLDS
from bcid.predict.kept_predictions import MeasurementPrediction
from bcid.predict.predictor import Predictor
from bcid.results.common_rows import ConstantRow
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
# A step that moves no number by more than this part of its scale ends the fit.
_XTOL = 1e-3
# So does one that changes chi-square by less than this part of it.
FTOL = 1e-4
# Step of a difference of whole trajectories, in scales; where what acts depends on the last step it jumps with every step that
# is halved in one of them only, and the difference must be large against that.
_STEP, _STEP_FROM_PAST = 1e-2, 0.3
# Up to so many scales further on such a difference serves as well: as far as its step reaches where that is large.
_ALIKE = 0.1
# Variance of a number of which nothing is seen.
_UNKNOWN = 1e200


@dataclass(frozen=True)
class Coordinate:
    """One fitted number, as the optimiser sees it.

    Attributes:
        name: full name in the model.
        parameter: what it is.
        scale: size of a notable change of the coordinate.
    """

    name: str
    parameter: Parameter
    scale: float

    @classmethod
    def of_parameter(cls, name: str, parameter: Parameter, scale: float | None = None) -> Coordinate:
        """With the parameter's own scale, or another."""
        size = scale or parameter.scale
        return cls(name, parameter, 1 / size if parameter.reciprocal else size)

    def of(self, value: float) -> float:
        """Coordinate of a value: the reciprocal for springs that replace a rigid hold."""
        return 1 / value if self.parameter.reciprocal else value

    value = of

    def allowed(self, at: float) -> float:
        """The value at a coordinate that may miss a bound by rounding."""
        lower, upper = self.bounds
        value = self.value(float(np.clip(at, lower, upper)))
        return float(np.clip(value, self.parameter.lower, self.parameter.upper))

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the coordinate."""
        p, inside = self.parameter, 1e-3 * self.scale
        lower = p.lower + inside if p.open_lower else p.lower
        upper = p.upper - inside if p.open_upper else p.upper
        if p.reciprocal:
            least = 1 / p.upper if math.isfinite(p.upper) else 1e-9 * self.scale
            return least, 1 / p.lower if p.lower > 0 else 1e4 * self.scale
        return lower, upper


def coordinates(model: Model, names: Sequence[str]) -> list[Coordinate]:
    """The named numbers of a model, as `Model.constants` has them.

    Raises:
        InputError: the model has no such number.
    """
    known = {p.name: model.law.supported(p, model.mixed, model.constants()[p.name]) for p in model.law.parameters}
    for term in model.terms:
        known |= {term.full(p.name): p for p in term.effect.parameters}
    found = []
    for name in names:
        if name not in known:
            raise InputError(f"the model {model.name} has no number '{name}'; {nearest(name, known)}")
        law = name in model.law.complete(model.values)
        scale = model.law.scale(known[name], model.values) if law else None
        found.append(Coordinate.of_parameter(name, known[name], scale))
    return found


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    Attributes:
        state: the model at its optimum, compared with the data.
        coordinates: what was fitted.
        covariance: of the coordinates, shape (p, p), with what the scene may have wrong in the place of effects.
        jacobian: of the scaled residual by the coordinates, shape (n, p).
        warnings: what is doubtful, in words.
        evaluations: predictions that were needed.
        settled: whether it came to an end by itself.
        limits: of numbers that ended at a bound, by full name, what they are on this side of with 95 %.
    """

    state: State
    coordinates: tuple[Coordinate, ...]
    covariance: Array
    jacobian: Array
    warnings: tuple[str, ...]
    evaluations: int
    settled: bool = True
    limits: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def at(cls, state: State) -> Fit:
        """A model as it is, of which nothing was fitted."""
        return cls(state, (), np.zeros((0, 0)), np.zeros((len(state.predictor.data), 0)), (), 0)

    @property
    def stiffness(self) -> Stiffness | None:
        """How stiff the body is, where forces are measured and none of the law's constants was fitted.

        Beside something unknown where that makes the measurement likelier: it may pull on the gripper as well.
        """
        state = self.state
        if set(state.model.stiffnesses) & set(state.free):
            return None
        columns = [-state.errors.unwhiten(column) for column in self.jacobian.T]
        fitted = np.column_stack(columns) if columns else None
        return Stiffness.of(state.likeliest_errors, state.residual, state.model, state.predictor.whole, fitted)

    @property
    def values(self) -> dict[str, float]:
        """Fitted values by full name."""
        numbers = self.state.model.constants()
        return {c.name: numbers[c.name] for c in self.coordinates}

    @property
    def law(self) -> dict[str, ConstantRow]:
        """Constants of the law that were fitted, by name, as they are reported (`bcid.inference.stiffness`).

        The 95 % interval of a stiffness is that of its logarithm.
        """
        scale = StiffnessScale.of(self.state.predictor.whole)
        known, errors, values = {p.name: p for p in self.state.model.law.parameters}, self.stderr, self.values
        found = {}
        for name, error in errors.items():
            if name not in known:
                continue
            value, unit = values[name], known[name].unit
            stiff, ends = unit == "Pa", _interval(value, error, unit)
            loose = error > UNTOLD or (stiff and ends[1] > UNTOLD * ends[0])
            one = scale.factor if stiff else 1.0
            found[name] = ConstantRow(
                value=value * one,
                stderr=None if loose else error * one,
                interval=None if loose else tuple(end * one for end in ends),
                unit=scale.unit if stiff else unit,
                per_thickness=stiff and scale.per_thickness,
            )
        return found

    @property
    def stderr(self) -> dict[str, float]:
        """Standard errors of the values; infinite where the data do not tell."""
        errors = np.sqrt(np.diag(self.covariance))
        numbers = self.state.model.constants()
        # The error of a reciprocal is that of its coordinate times the square of the value.
        return {
            c.name: float(e) * (numbers[c.name] ** 2 if c.parameter.reciprocal else 1.0)
            for c, e in zip(self.coordinates, errors, strict=True)
        }


def _interval(value: float, error: float, unit: str) -> tuple[float, float]:
    """Of a constant with 95 %."""
    if unit == "Pa" and value > 0:
        factor = math.exp(min(WIDE * error / value, 700.0))
        return value / factor, value * factor
    return value - WIDE * error, value + WIDE * error


class _Problem:
    """What the optimiser calls: scaled residual and Jacobian at given coordinates; `like` is an earlier fit of them."""

    def __init__(self, start: State, coordinates: Sequence[Coordinate], like: Fit | None = None) -> None:
        self.start, self.coordinates = start, list(coordinates)
        self._slopes = None if like is None else _slopes(like)
        self.predictor, self.anchors, self.errors = start.predictor, start.anchors, start.errors
        self._known: dict[bytes, tuple[Model, MeasurementPrediction]] = {}
        self._last = start.scaled
        self.evaluations, self.blocked = 0, False

    def model(self, x: Array) -> Model:
        """The model at these coordinates."""
        values = {c.name: c.allowed(float(at)) for c, at in zip(self.coordinates, x, strict=True)}
        return self.start.model.with_values(values)

    def prediction(self, x: Array) -> tuple[Model, MeasurementPrediction]:
        """The prediction there; the last few are kept."""
        key = np.asarray(x, dtype=float).tobytes()
        if key not in self._known:
            try:
                model = self.model(x)
            except InputError as error:
                # Each constant is within its range, but a law may not allow them together.
                nothing = np.full(self.predictor.data.mask.shape, np.nan)
                return self.start.model, MeasurementPrediction(nothing, {}, str(error))
            self._known = dict(list(self._known.items())[-1:])
            self.predictor.progress.step(f"fitting {model.name}", self.evaluations)
            self._known[key] = model, self.predictor.predict(model, self.anchors, keep=True)
            self.evaluations += 1
        return self._known[key]

    def residual(self, x: Array) -> Array:
        """Scaled residual; where the model fails, a worse one than before, so that the step is refused."""
        _, prediction = self.prediction(x)
        if prediction.failure:
            self.blocked = True
            return 3.0 * self._last
        found = self.scaled(prediction)
        self._last = found
        return found

    def scaled(self, prediction: MeasurementPrediction) -> Array:
        """Scaled residual of a prediction."""
        data = self.predictor.data
        return self.errors.whiten(data.values - data.vector(prediction.positions + self.errors.mesh.correction))

    def jacobian(self, x: Array) -> Array:
        """Its derivative by the coordinates.

        Where that takes differences of whole trajectories it serves as far as these differences reach.

        Raises:
            SolveError: it is not finite.
        """
        model, prediction = self.prediction(x)
        if prediction.failure:
            return np.zeros((len(self.predictor.data), len(self.coordinates)))
        if self._slopes is not None and model.remembers and self._near(x, self._slopes[0]):
            return -self.errors.whiten(self._slopes[1])
        found = columns(self.predictor, model, self.anchors, prediction, self.coordinates)
        if not np.isfinite(found).all():
            unknown = [
                c.name for c, column in zip(self.coordinates, found.T, strict=True) if not np.isfinite(column).all()
            ]
            raise SolveError(f"{model.name}: the influence of {', '.join(unknown)} is not finite")
        self._slopes = np.array(x), found
        return -self.errors.whiten(found)

    def _near(self, x: Array, known: Array) -> bool:
        past = _from_past(self.start.model)
        reach = np.array([(_STEP_FROM_PAST if c.name in past else _ALIKE) * c.scale for c in self.coordinates])
        return bool(np.all(np.abs(x - known) <= reach))


def _slopes(found: Fit) -> tuple[Array, Array] | None:
    """Coordinates of a fit, and change of every measured coordinate per unit of each, m."""
    if not found.coordinates:
        return None
    numbers = found.state.model.constants()
    errors = found.state.errors
    moved = [-errors.unwhiten(column) for column in found.jacobian.T]
    return np.array([c.of(numbers[c.name]) for c in found.coordinates]), np.column_stack(moved)


def columns(
    predictor: Predictor,
    model: Model,
    anchors: frozenset[str],
    prediction: MeasurementPrediction,
    coordinates: Sequence[Coordinate],
) -> Array:
    """Change of every measured coordinate per unit of each fitted one, shape (n, p), m; collective.

    By the tangent; where effects remember earlier steps, by differences of whole trajectories.
    """
    if not coordinates:
        return np.zeros((len(predictor.data), 0))
    if model.remembers:
        return _differences(predictor, model, anchors, prediction, coordinates)
    names = [c.name for c in coordinates]
    probes = []
    for term in model.terms:
        wanted = tuple(p.name for p in term.effect.parameters if term.full(p.name) in names)
        if wanted:
            probes.append(Probe(term, wanted))
    law = tuple(n for n in names if n in model.law.complete(model.values))
    found = predictor.sensitivities(model, anchors, prediction, SensitivityRequest(tuple(probes), law))
    table = dict(found.law)
    for probe, arrays in zip(probes, found.probes, strict=True):
        table |= {probe.term.full(name): array for name, array in arrays.items()}
    return np.column_stack([predictor.data.vector(table[name]) for name in names])


def _differences(
    predictor: Predictor,
    model: Model,
    anchors: frozenset[str],
    prediction: MeasurementPrediction,
    coordinates: Sequence[Coordinate],
) -> Array:
    found, numbers = [], model.constants()
    past = _from_past(model)
    for c in coordinates:
        at = c.of(numbers[c.name])
        lower, upper = c.bounds
        step = (_STEP_FROM_PAST if c.name in past else _STEP) * c.scale
        step = step if at + step <= upper else -step
        moved = predictor.predict(model.with_values({c.name: c.value(max(at + step, lower))}), anchors)
        change = (moved.positions - prediction.positions) / step
        found.append(predictor.data.vector(np.nan_to_num(change)))
    return np.column_stack(found)


def _bounds(start: State, c: Coordinate) -> tuple[float, float]:
    """Bounds of a coordinate, and those of the body where it lies within that."""
    lower, upper = c.bounds
    if not c.parameter.within:
        return lower, upper
    low, high = start.room(c.parameter.within)
    return max(lower, low), min(upper, high)


def _from_past(model: Model) -> set[str]:
    """Numbers of effects that depend on the last step."""
    return {term.full(p.name) for term in model.terms if term.effect.uses_past for p in term.effect.parameters}


def fit(start: State, names: Sequence[str], most: int = 12, ftol: float = FTOL, like: Fit | None = None) -> Fit:
    """Fit numbers of a model to the data; collective.

    Amounts are those of the maximum of the posterior with the widest prior, one of `Priors.widest` notable ones about
    none: it moves only what the data hardly tell, such as the stiffness of a contact that is already as good as rigid. Other
    numbers have the prior that they declare, if any.

    Args:
        start: where to begin; its covariance of errors is kept but for nuisances that are fitted.
        names: full names of the numbers.
        most: predictions at most.
        ftol: relative change of chi-square that ends the fit.
        like: a fit of the same numbers with the same anchors, of which the derivatives serve where these are dear.

    Raises:
        InputError: the model has no such number.
        SolveError: the model cannot be followed at its start, or the influence of its numbers.
    """
    chosen = coordinates(start.model, names)
    # What is fitted is not integrated over besides.
    start = replace(start, errors=start.errors.without(fitted_instead(start.model, names)))
    problem = _Problem(start, chosen, like if like and [c.name for c in like.coordinates] == list(names) else None)
    if not chosen:
        return Fit.at(replace(start, free=()))
    numbers = start.model.constants()
    lower, upper = (np.array(b) for b in zip(*(_bounds(start, c) for c in chosen), strict=True))
    scale = np.array([c.scale for c in chosen])
    x = np.clip([c.of(numbers[c.name]) for c in chosen], lower, upper)
    inside = np.clip(x, lower + 1e-6 * scale, upper - 1e-6 * scale)
    if problem.prediction(inside)[1].failure:
        raise SolveError(f"{start.model.name}: {problem.prediction(inside)[1].failure}")
    # In units of their scales: the optimiser takes a step of 1e-6 for none, and a compliance may be smaller than that.
    pull, expected = pulls(start.model, chosen)
    result = least_squares(
        lambda z: np.append(problem.residual(z * scale), pull @ (z - expected)),
        inside / scale,
        jac=lambda z: np.vstack([problem.jacobian(z * scale) * scale, pull]),
        bounds=(lower / scale, upper / scale),
        xtol=_XTOL,
        ftol=ftol,
        gtol=1e-10,
        max_nfev=most,
    )
    x = result.x * scale
    model, prediction = problem.prediction(x)
    state = replace(start, model=model, prediction=prediction, free=tuple(names))
    jacobian = np.asarray(result.jac)[: len(start.predictor.data)] / scale
    told = pull[:, [c.parameter.neutral is None for c in chosen]].any(axis=1)
    covariance = _covariance(np.vstack([jacobian, pull[told] / scale]), scale)
    apart = x - np.array([_none(model, c) for c in chosen])
    loose = _loose(apart / scale, np.sqrt(np.diag(covariance)) / scale)
    warnings = _warnings(chosen, x, lower, upper, scale, loose)
    settled = result.status != 0
    if problem.blocked or not settled:
        # By as much as the step that was not taken its numbers may be off besides.
        left = _left(result.jac, result.fun, result.active_mask) * scale
        if problem.blocked and (np.abs(left) > np.sqrt(np.diag(covariance))).any():
            warnings.append("the fit ended where the model cannot be followed any further")
        elif not settled:
            warnings.append(f"the fit did not settle within {most} predictions")
        covariance = covariance + np.outer(left, left)
    if start.replaced.size:
        beside = _shifts(jacobian * scale, start.errors.whiten(start.replaced)) * scale[:, None]
        covariance = covariance + beside @ beside.T
    onward = _shifts(result.jac, -result.fun[:, None])[:, 0] * scale
    limits = _limits(chosen, x, (lower, upper, scale), np.sqrt(np.diag(covariance)), onward)
    return Fit(state, tuple(chosen), covariance, jacobian, tuple(warnings), problem.evaluations, settled, limits)


def pulls(model: Model, chosen: Sequence[Coordinate]) -> tuple[Array, Array]:
    """What the prior pulls numbers with, (m, p), and what was expected of each, (p,), both in their scales."""
    pulls, expected = np.zeros(len(chosen)), np.zeros(len(chosen))
    for k, c in enumerate(chosen):
        p = c.parameter
        if p.neutral is not None:
            pulls[k], expected[k] = 1 / PRIORS.widest, (0.0 if p.reciprocal else model.neutral(p) or 0.0) / c.scale
        elif p.prior is not None and c.scale == p.scale:
            pulls[k], expected[k] = p.scale / p.prior[1], p.prior[0] / p.scale
    return np.diag(pulls)[pulls > 0], expected


def _shifts(jacobian: Array, columns: Array) -> Array:
    """By how much fitted numbers are off where the data hold one of each column (n, k) besides; shape (p, k)."""
    return np.asarray(np.linalg.lstsq(jacobian, columns, rcond=1e-8)[0])


def _left(jacobian: Array, residual: Array, at_bounds: NDArray[np.int64]) -> Array:
    """The Gauss-Newton step that a fit would take next, of numbers that are not at a bound; shape (p,)."""
    step, free = np.zeros(jacobian.shape[1]), at_bounds == 0
    step[free] = -_shifts(jacobian[:, free], residual[:, None])[:, 0]
    return step


def _none(model: Model, c: Coordinate) -> float:
    """The coordinate of an amount where it is none; no number for what is no amount."""
    neutral = model.neutral(c.parameter)
    return 0.0 if c.parameter.reciprocal else math.nan if neutral is None else c.of(neutral)


def _loose(apart: Array, errors: Array) -> NDArray[np.bool_]:
    """Which numbers neither the data tell nor a prior that they declare, from their standard errors and what amounts there are.

    Both in their scales; of what is no amount `apart` is no number.
    """
    return np.asarray(
        (errors > THRESHOLDS.detection) & ~(np.abs(apart) > normal_quantile((1 + THRESHOLDS.credible) / 2) * errors)
    )


def _covariance(jacobian: Array, scale: Array) -> Array:
    """Inverse of J^T J, which has the rows of the data and of what a prior declares."""
    scaled = jacobian * scale
    _, sizes, rows = np.linalg.svd(scaled, full_matrices=False)
    least = max(1e-8 * sizes.max(initial=0.0), 1e-150)
    covariance = (rows.T / np.maximum(sizes, least) ** 2) @ rows
    # A number that takes part in a direction of which nothing is seen; the others keep their errors.
    unseen = np.sum(rows[sizes <= least] ** 2, axis=0) > 1e-6
    covariance[unseen, unseen] = _UNKNOWN
    return np.asarray(covariance * np.outer(scale, scale))


def _at_bound(at: float, low: float, high: float, size: float) -> bool:
    return min(at - low, high - at) < 1e-3 * size


def _limits(
    chosen: Sequence[Coordinate], x: Array, within: tuple[Array, Array, Array], errors: Array, onward: Array
) -> dict[str, float]:
    """Limits of numbers at a bound, or that would be beyond it, from a normal distribution that ends there.

    A number of which the data show nothing has none.

    Args:
        chosen: the coordinates.
        x: where they ended.
        within: their bounds and scales.
        errors: their standard deviations.
        onward: the step that they would take without bounds.
    """
    found = {}
    for c, at, low, high, size, error, step in zip(chosen, x, *within, errors, onward, strict=True):
        inside = low < at + step < high and not _at_bound(at, low, high, size)
        if inside or c.parameter.period is not None or error > UNTOLD:
            continue
        bound, inward = (low, 1.0) if at - low < high - at else (high, -1.0)
        end = bound + inward * error * limit_beyond(
            max(inward * (bound - at - step) / error, 0.0), 1 - THRESHOLDS.credible
        )
        if low < end < high:
            found[c.name] = c.value(float(end))
    return found


def _warnings(
    chosen: Sequence[Coordinate], x: Array, lower: Array, upper: Array, scale: Array, loose: NDArray[np.bool_]
) -> list[str]:
    found = []
    for c, at, low, high, size, free in zip(chosen, x, lower, upper, scale, loose, strict=True):
        if _at_bound(at, low, high, size):
            found.append(
                f"{c.name} is at a bound ({c.value(float(at)):.4g} {c.parameter.unit}; allowed: {c.parameter.allowed})"
            )
        if free:
            found.append(f"{c.name} is not identifiable from these data")
    return found
