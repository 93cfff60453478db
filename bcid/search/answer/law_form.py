"""What data say of the form of the law at large strains, of which the scene may have a little wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.base.units import WIDE, uncertain
from bcid.forms.model import Model
from bcid.forms.scene_errors import SECOND_INVARIANT, law_form_term
from bcid.results.proposal_record import CoefficientRow
from bcid.search.fitting.fit import Fit

Array = NDArray[np.float64]
_LAW = "law"


@dataclass(frozen=True)
class LawForm:
    """How the law differs from that of a model.

    Attributes:
        values: coefficient of (I1bar - 3)^2 in shear moduli, and the part of the shear modulus that goes with the second
            invariant, by four, shape (2,).
        stderr: their standard errors, shape (2,).
        allowed: the standard deviation of both that the scene states.
    """

    values: Array
    stderr: Array
    allowed: float

    @classmethod
    def of(cls, fitted: Fit) -> LawForm | None:
        """What a fit leaves to it; None where the scene does not allow for it, or the model says it itself."""
        state = fitted.state
        errors = state.errors
        if errors.nuisances.names.count(_LAW) != len(law_form_term().values):
            return None
        slopes = [state.errors.unwhiten(column) for column in fitted.jacobian.T]
        means, covariance = errors.values(state.residual, _LAW, np.column_stack(slopes) if slopes else None)
        size = errors.nuisances.sizes[_LAW]
        return cls(size * means, size * np.sqrt(np.diag(covariance)), size)

    @property
    def seen(self) -> bool:
        """Whether the law is off for sure (95 %)."""
        return bool(np.any(np.abs(self.values) > WIDE * self.stderr))

    def beside(self, model: Model) -> Model:
        """A model whose law has this form."""
        term = law_form_term()
        return model + term.with_values(dict(zip(term.values, map(float, self.values), strict=True)))

    @property
    def text(self) -> str:
        """In words and numbers."""
        (first, second), (first_error, second_error) = self.values, WIDE * self.stderr
        percents = 100 * SECOND_INVARIANT
        share = uncertain(percents * second, percents * second_error, "%")
        squared = uncertain(first, first_error)
        return (
            f"The law has another form: {share} of the shear modulus go with the second invariant, and {squared} shear moduli with "
            f"(I1bar - 3)^2 (95 %). The scene allows for {percents * self.allowed:.2g} % and {self.allowed:.2g} "
            "(standard deviations: law in its [uncertainty])."
        )

    def rows(self) -> dict[str, CoefficientRow]:
        """As results hold it."""
        names, times = ("first_squared", "second_invariant"), (1.0, SECOND_INVARIANT)
        return {
            name: CoefficientRow(value=by * float(value), stderr=by * float(error), allowed=by * self.allowed)
            for name, by, value, error in zip(names, times, self.values, self.stderr, strict=True)
        }
