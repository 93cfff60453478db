"""What is known of a candidate anchor set once it has been evaluated, and who holds what was evaluated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bcid.forms.solver.status import Status
from bcid.inference.misfit import Misfit

Array = NDArray[np.float64]
Candidate = frozenset[str]


def label(candidate: Iterable[str], order: Iterable[str]) -> str:
    """A candidate in words, patches in the scene's order: "{1 2}"."""
    chosen = set(candidate)
    return "{" + " ".join(name for name in order if name in chosen) + "}"


@dataclass(frozen=True)
class Outcome:
    """What is known of one candidate on one level.

    Attributes:
        chi2: sum of squared residuals in units of noise; a lower bound when `complete` is False, for its bound was passed;
            infinite when the model failed.
        rms: RMS residual per coordinate, m; a lower bound when `complete` is False.
        complete: whether all frames were compared.
        share: fraction of the steps of the trajectory that was computed, 0 to 1.
        status, reason: how the forward model ended, and why in words.
        seconds: time spent.
        by_frame: chi-square of each frame, NaN where it was not come to: what sets are compared by, on the frames that both
            have.
    """

    candidate: Candidate
    level: int
    chi2: float
    rms: float
    complete: bool
    share: float
    status: Status = Status.CONVERGED
    reason: str = ""
    seconds: float = 0.0
    by_frame: tuple[float, ...] = ()

    def beyond(self, other: Outcome) -> float:
        """By how much its chi-square exceeds another's, over the frames that both have."""
        here, there = np.array(self.by_frame), np.array(other.by_frame)
        return float(np.nansum(here - there))

    @property
    def failed(self) -> bool:
        """Whether the forward model found no acceptable equilibrium."""
        return self.status is not Status.CONVERGED


class Evaluated(Protocol):
    """Holds the outcomes of a search; `bcid.search.evaluator.Evaluator` is one. `positions` and `refinement` are collective."""

    outcomes: dict[tuple[int, Candidate], Outcome]
    misfit: Misfit

    @property
    def patches(self) -> list[str]:
        """Names of the candidate patches, in the scene's order."""
        ...

    def positions(self, level: int, candidate: Candidate) -> Array:
        """Predicted fiducial positions of one candidate, shape (frames, fiducials, 3), m."""
        ...

    def refinement(self, coarse: int, fine: int) -> float:
        """How many times smaller the elements of a level are than a coarser one's."""
        ...
