"""The error of a mesh level, from two levels of the ladder."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.inference.priors import PRIORS

Array = NDArray[np.float64]
# Between levels that hardly differ nothing can be extrapolated.
_LEAST = 0.2
# By this power of the size of elements errors of positions fall on a ladder of one degree.
ORDER = 2


def gain(refinement: float, order: int = ORDER) -> float:
    """By how much the distance of two levels exceeds the error of the finer one, which falls so with the size of elements.

    Args:
        refinement: cube root of the ratio of their unknowns.
        order: power of the size of elements.
    """
    return max(refinement**order - 1, _LEAST)


def gains(refinement: float, degree: int, kinds: NDArray[np.int64]) -> Array:
    """The same for rows of some kinds, where the finer level has elements of this degree, shape (rows, 1).

    Errors of positions are taken to be of the order of that degree, one less than where solutions are smooth: somewhere a patch
    always ends. Those of forces are of one order less: they are derivatives of the energy, whose error is the square of that of
    the strains, and those are singular where patches and grasp end (Strang & Fix, An Analysis of the Finite Element Method, 1973,
    chapter 8).

    Args:
        refinement: cube root of the ratio of their unknowns.
        degree: of the finer elements.
        kinds: 0 for positions, 1 and 2 for force and torque.
    """
    return np.where(kinds == 0, gain(refinement, degree), gain(refinement, max(degree - 1, 1)))[:, None]


@dataclass(frozen=True)
class MeshError:
    """What the mesh ladder says of the error of the working level.

    Attributes:
        correction: what to add to a prediction of the working level, shape (frames, rows, 3), m.
        left: what may be left after it, of the same shape, m; zero when nothing is known.
        known: whether there was a second level to compare with.
        about: name of the model and set of anchors that it was found with; for others it is a good guess.
        fiducials: how many rows are fiducials (the others are force and torque); None where all are.
    """

    correction: Array
    left: Array
    known: bool
    about: tuple[str, frozenset[str]] = ("", frozenset())
    fiducials: int | None = None

    @property
    def rms(self) -> float:
        """RMS of what may be left of positions, m."""
        return float(np.sqrt(np.nanmean(self.left[:, : self.fiducials] ** 2)))

    def at(self, frames: NDArray[np.int64]) -> MeshError:
        """The same in some of the frames."""
        return replace(self, correction=self.correction[frames], left=self.left[frames])

    @classmethod
    def unknown(cls, shape: tuple[int, ...]) -> MeshError:
        """Nothing to compare with."""
        return cls(np.zeros(shape), np.zeros(shape), False)

    @classmethod
    def beyond(cls, coarse: Array, fine: Array, gain: float | Array) -> MeshError:
        """The same where the finer of the two is the working level."""
        difference = fine - coarse
        return cls(np.asarray(difference / gain), np.asarray(difference / np.minimum(gain, PRIORS.mesh_gain)), True)

    @classmethod
    def between(cls, coarse: Array, fine: Array, gain: float | Array) -> MeshError:
        """From predictions on the working level and a finer one: Richardson's extrapolation.

        `gain` is how many times the difference exceeds the error of the finer one (3 for halved elements of second order).
        What is left is taken to be larger than that: see `Priors.mesh_gain`.
        """
        difference = fine - coarse
        return cls(
            np.asarray(difference * (1 + 1 / gain)), np.asarray(difference / np.minimum(gain, PRIORS.mesh_gain)), True
        )
