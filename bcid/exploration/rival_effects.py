"""Rival effects: each is fitted to all pulls, with the anchor sets that go with it, and its evidence is compared with theirs.

An effect that could have been seen and was not loses, and one that these pulls would not show keeps its chance (see
`bcid.inference.evidence`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.base.errors import SolveError
from bcid.comparison.coarse_search import CoarseSearch
from bcid.comparison.few_steps import in_few_steps
from bcid.comparison.fit import Fit
from bcid.comparison.fitted_hypothesis import FittedHypothesis, best_first, promoted
from bcid.comparison.parameter_priors import expected
from bcid.comparison.state import State
from bcid.exploration.joined import joined
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.inference.discrepancy import Evidence
from bcid.inference.hypotheses import Anchored, Hypothesis
from bcid.measurement import Measurement
from bcid.predict.predictor import Predictor
from bcid.scene import Scene

Array = NDArray[np.float64]
# Sets weighed together with the effects at most.
_SETS = 28
# An effect is fitted with so many sets on average, and kept with so many.
_FITS, _KEPT = 3, 3
# A set is kept with odds of at least exp(-_NEAR) against the best one of the effect, as a few steps of each pull tell.
_NEAR = 10.0
# What these pulls do not show may show in those to come: it keeps its chance.
_UNSEEN = 0.0


@dataclass(frozen=True)
class Fitted:
    """A hypothesis with its numbers fitted to all pulls.

    Attributes:
        hypothesis: set and effect.
        rival: the fit, and its evidence with and without an unknown force besides.
        begun: the model without the effect.
    """

    hypothesis: Hypothesis
    rival: FittedHypothesis
    begun: Model

    @property
    def evidence(self) -> Evidence:
        """Of the hypothesis, with and without an unknown force besides."""
        return self.rival.evidence

    @property
    def fitted(self) -> Fit:
        """The fit."""
        return self.rival.fitted

    @cached_property
    def model(self) -> Model:
        """The model with the likeliest numbers: what the pulls do not tell is as it was expected."""
        apart, size = self._before
        numbers = self.fitted.state.model.constants()
        back = size * np.linalg.solve(self._precision, apart / size) if len(size) else apart
        at = {c.name: c.of(numbers[c.name]) - b for c, b in zip(self.fitted.coordinates, back, strict=True)}
        return self.fitted.state.model.with_values({c.name: c.allowed(at[c.name]) for c in self.fitted.coordinates})

    @property
    def rms(self) -> float:
        """RMS residual, m."""
        return self.fitted.state.rms

    @property
    def missed(self) -> float:
        """RMS residual in units of its errors."""
        return math.sqrt(self.fitted.state.chi2 / len(self.fitted.state.predictor.data))

    @cached_property
    def deviating(self) -> list[Model]:
        """The model with its numbers one standard deviation off, one model for each independent combination of them."""
        numbers = self.model.constants()
        coordinates = self.fitted.coordinates
        if not coordinates:
            return []
        _, size = self._before
        covariance = size[:, None] * np.linalg.inv(self._precision) * size
        found = []
        for column in np.linalg.cholesky(covariance).T:
            # Where the limit of a number is near it deviates to the other side.
            values = {}
            for c, step in zip(coordinates, column, strict=True):
                at, (lower, upper) = c.of(numbers[c.name]), c.bounds
                values[c.name] = c.allowed(at + step if lower <= at + step <= upper else at - step)
            found.append(self.model.with_values(values))
        return found

    @property
    def amounts(self) -> dict[str, tuple[float, float]]:
        """Fitted numbers of the effect by full name, with standard errors."""
        return {name: (value, self.fitted.stderr[name]) for name, value in self.fitted.values.items()}

    def unit(self, name: str) -> str:
        """Unit of one of them."""
        return next(c.parameter.unit for c in self.fitted.coordinates if c.name == name)

    @cached_property
    def _before(self) -> tuple[Array, Array]:
        """How far the fitted coordinates are from what was expected, and its standard deviation."""
        return expected(self.fitted.state, self.begun)

    @cached_property
    def _precision(self) -> Array:
        """Of the numbers, in units of what was believed before, (p, p)."""
        _, size = self._before
        jacobian = self.fitted.jacobian * size
        return np.asarray(np.eye(len(size)) + jacobian.T @ jacobian)


class RivalEffects:
    """Fits effects to pulls. `look` is collective on `comm`, with the same result on all ranks.

    Args:
        scene: the scene.
        comm: an MPI communicator.
        level: fine level (see `Predictor`).
        effects: the effects that may act.

    Attributes:
        names: of the effects.
    """

    def __init__(self, scene: Scene, comm: Comm, level: int | None, effects: Sequence[Effect]) -> None:
        self.scene, self.comm, self.level, self.effects = scene, comm, level, list(effects)
        self.names = tuple(effect.name for effect in effects)
        self._predictor: Predictor | None = None
        # By effect, its best set after the pulls before.
        self._sets: dict[str, Anchored] = {}

    def look(self, pulls: Sequence[Measurement], likely: Iterable[Anchored]) -> list[Fitted]:
        """Hypotheses with numbers that fit all pulls: the likely sets alone, and each effect with a few sets.

        Nothing when the body cannot be followed with any of the likely sets.
        """
        measurement = joined(pulls, self.scene)
        self._predictor = self._predictor or Predictor(self.scene, measurement, self.comm, self.level)
        predictor = self._predictor.repeating(measurement)
        begun = Model.of(self.scene)
        alone = [
            s for s in (_followed(predictor, begun, a) for a in dict.fromkeys([*likely, *self._sets.values()])) if s
        ]
        if not alone:
            return []
        acting = [e for e in self.effects if not (e.needs and e.needs(self.scene, measurement))]
        plain = best_first(FittedHypothesis.of(Fit.at(s), begun, len(acting)) for s in alone)
        base, others = plain[0].fitted.state, [rival.anchors for rival in plain[1:]]
        coarse = _fitted_coarsely(base, begun, acting, others)
        found = [Fitted(Hypothesis(r.anchors), r, begun) for r in plain]
        for name, rivals in coarse.items():
            fitted = best_first(r for r in (promoted(one, base, begun, _UNSEEN) for one in rivals) if r)
            found += [Fitted(Hypothesis(r.anchors, name), r, begun) for r in fitted]
            if fitted:
                self._sets[name] = fitted[0].anchors
        predictor.drop([begun, *(f.model for f in found)])
        return found

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._predictor is not None:
            self._predictor.destroy()


def _followed(predictor: Predictor, model: Model, anchors: Anchored) -> State | None:
    try:
        return State.of(predictor, model, anchors)
    except SolveError:
        return None


def _fitted_coarsely(
    base: State, begun: Model, effects: Sequence[Effect], others: Sequence[Anchored]
) -> dict[str, list[FittedHypothesis]]:
    """Effects fitted to a few steps of each pull, each with the sets that may go with it, the best first."""
    count = len(effects)
    search = CoarseSearch(in_few_steps(base), begun, effects, count, _SETS, _FITS * count, others, least=_UNSEEN)
    search.run()
    found = {}
    for name in (effect.name for effect in effects):
        # What these pulls do not show may show in those to come: each is fitted.
        search.fit_effect(name)
        rivals = [r for r in search.table.full if r.names == (name,) and math.isfinite(r.log)]
        if rivals:
            found[name] = [r for r in rivals if r.log > rivals[0].log - _NEAR][:_KEPT]
    return found
