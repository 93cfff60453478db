"""Numbers of a hypothesis as the pulls show them, and how they may deviate in a pull to come."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from bcid.forms.model import Model
from bcid.inference.evidence import LinearParameters
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.parameter_priors import of_state

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FittedNumbers:
    """A hypothesis with its numbers fitted to all pulls.

    Attributes:
        hypothesis: with its fit.
        numbers: what was believed of them, about the fit.
    """

    hypothesis: FittedHypothesis
    numbers: LinearParameters

    @classmethod
    def of(cls, hypothesis: FittedHypothesis, begun: Model) -> FittedNumbers | None:
        """Of a fit of a model that was begun from another; None where the pulls could not show its amounts. Collective."""
        fitted = hypothesis.fitted
        numbers = of_state(fitted.state, begun, fitted.jacobian)
        return cls(hypothesis, numbers) if numbers else None

    @cached_property
    def model(self) -> Model:
        """The model with the mean of its numbers: what the pulls do not determine is as it was expected."""
        fitted = self.hypothesis.fitted
        numbers, (back, _) = fitted.state.model.constants(), self._posterior
        at = {c.name: c.of(numbers[c.name]) - b for c, b in zip(fitted.coordinates, back, strict=True)}
        return fitted.state.model.with_values({c.name: c.allowed(at[c.name]) for c in fitted.coordinates})

    @cached_property
    def deviating(self) -> list[Model]:
        """The model with its numbers one standard deviation off, one model for each independent combination of them."""
        numbers = self.model.constants()
        coordinates = self.hypothesis.fitted.coordinates
        if not coordinates:
            return []
        _, covariance = self._posterior
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
    def _posterior(self) -> tuple[Array, Array]:
        """By how much the mean of the coordinates lies below the fit, (p,), and their covariance: moments over all widths.

        About a fit, where the residual does not change with the numbers to first order (Rasmussen & Williams, Gaussian Processes
        for Machine Learning, 2006, equation 2.8).
        """
        known, count = self.numbers, len(self.numbers.apart)
        gram = known.columns.T @ known.columns
        logs, backs, covariances = [], [], []
        for width in known.widths:
            inside = np.linalg.inv(np.eye(count) + width[:, None] * gram * width)
            apart = known.apart / width
            logs.append(0.5 * np.linalg.slogdet(inside)[1] - 0.5 * apart @ (apart - inside @ apart))
            backs.append(width * (inside @ apart))
            covariances.append(width[:, None] * inside * width)
        shares = softmax(logs)
        mean = shares @ np.array(backs)
        spread = [c + np.outer(b - mean, b - mean) for c, b in zip(covariances, backs, strict=True)]
        return mean, np.einsum("k,kij->ij", shares, np.array(spread))
