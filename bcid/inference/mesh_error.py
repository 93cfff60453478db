"""The error of a mesh level, from two levels of the ladder."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Where patches end, convergence is of little more than first order: by so much the difference of two meshes with a ratio
# of three exceeds the error of the finer one.
_SINGULAR = 3.0


@dataclass(frozen=True)
class MeshError:
    """What the mesh ladder says of the error of the working level.

    Attributes:
        correction: what to add to a prediction of the working level, shape (frames, fiducials, 3), m.
        left: what may be left after it, of the same shape, m; zero when nothing is known.
        known: whether there was a second level to compare with.
        about: name of the model and set of anchors that it was found with; for others it is a good guess.
    """

    correction: Array
    left: Array
    known: bool
    about: tuple[str, frozenset[str]] = ("", frozenset())

    @property
    def rms(self) -> float:
        """RMS of what may be left, m."""
        return float(np.sqrt(np.nanmean(self.left**2)))

    def at(self, frames: NDArray[np.int64]) -> MeshError:
        """The same in some of the frames."""
        return replace(self, correction=self.correction[frames], left=self.left[frames])

    @classmethod
    def unknown(cls, shape: tuple[int, ...]) -> MeshError:
        """Nothing to compare with."""
        return cls(np.zeros(shape), np.zeros(shape), False)

    @classmethod
    def beyond(cls, coarse: Array, fine: Array, gain: float) -> MeshError:
        """The same where the finer of the two is the working level."""
        difference = fine - coarse
        return cls(np.asarray(difference / gain), np.asarray(difference / min(gain, _SINGULAR)), True)

    @classmethod
    def between(cls, coarse: Array, fine: Array, gain: float) -> MeshError:
        """From predictions on the working level and a finer one: Richardson's extrapolation.

        `gain` is how many times the difference exceeds the error of the finer one (3 for halved elements of second order).
        What is left is taken to be larger than that: see `_SINGULAR`.
        """
        difference = fine - coarse
        return cls(np.asarray(difference * (1 + 1 / gain)), np.asarray(difference / min(gain, _SINGULAR)), True)
