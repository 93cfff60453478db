"""Numbers of a hypothesis as the pulls show them, and how they may deviate in a pull to come."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.comparison.fitted_hypothesis import FittedHypothesis
from bcid.comparison.parameter_priors import expected
from bcid.forms.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FittedNumbers:
    """A hypothesis with its numbers fitted to all pulls.

    Attributes:
        hypothesis: with its fit.
        begun: the model without added effects.
    """

    hypothesis: FittedHypothesis
    begun: Model

    @cached_property
    def model(self) -> Model:
        """The model with the most probable numbers: what the pulls do not determine is as it was expected."""
        apart, size = self._before
        fitted = self.hypothesis.fitted
        numbers = fitted.state.model.constants()
        back = size * np.linalg.solve(self._precision, apart / size) if len(size) else apart
        at = {c.name: c.of(numbers[c.name]) - b for c, b in zip(fitted.coordinates, back, strict=True)}
        return fitted.state.model.with_values({c.name: c.allowed(at[c.name]) for c in fitted.coordinates})

    @cached_property
    def deviating(self) -> list[Model]:
        """The model with its numbers one standard deviation off, one model for each independent combination of them."""
        numbers = self.model.constants()
        coordinates = self.hypothesis.fitted.coordinates
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
        fitted = self.hypothesis.fitted
        return {name: (value, fitted.stderr[name]) for name, value in fitted.values.items()}

    def unit(self, name: str) -> str:
        """Unit of one of them."""
        return next(c.parameter.unit for c in self.hypothesis.fitted.coordinates if c.name == name)

    @cached_property
    def _before(self) -> tuple[Array, Array]:
        """How far the fitted coordinates are from what was expected, and its standard deviation."""
        return expected(self.hypothesis.fitted.state, self.begun)

    @cached_property
    def _precision(self) -> Array:
        """Of the numbers, in units of their prior standard deviations, (p, p)."""
        _, size = self._before
        jacobian = self.hypothesis.fitted.jacobian * size
        return np.asarray(np.eye(len(size)) + jacobian.T @ jacobian)
