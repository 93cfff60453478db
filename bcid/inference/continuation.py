"""A measurement as far as a model can follow it: what comes after says nothing for or against it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.measurement import Measurement

T = TypeVar("T")


class ContinuationError(SolveError):
    """No hypothesis that was tried could be followed to the end.

    Args:
        message: why.
        remark: what could not be followed, in words, as "no anchor set can be followed".
        frames: which frames some hypothesis came to, shape (frames,).
    """

    def __init__(self, message: str, remark: str, frames: NDArray[np.bool_]) -> None:
        super().__init__(message)
        self.remark, self.frames = remark, frames

    def before(self, measurement: Measurement) -> Measurement:
        """The measurement up to there, with a remark; actions of which only the rest is left are left out.

        Raises:
            ContinuationError: nothing is left, or nothing is gained.
        """
        kept, remarks = np.zeros(len(measurement.positions), dtype=bool), []
        for action in measurement.actions:
            came = np.flatnonzero(self.frames[action.frames])
            count = int(came[-1]) + 1 if len(came) else 0
            if count == len(action):
                kept[action.frames] = True
                continue
            if count > 1:
                kept[action.frames[:count]] = True
                until = f"is compared up to step {action.steps[count - 1]} only"
            else:
                until = "is not compared"
            remarks.append(f"action {action.name} {until}: {self.remark} any further")
        if not kept.any() or not remarks:
            raise self
        data = measurement.data.isel(frame=np.flatnonzero(kept))
        return replace(measurement, data=data, remarks=(*measurement.remarks, *remarks))


def truncate_to_converged(measurement: Measurement, work: Callable[[Measurement], T]) -> T:
    """What work makes of a measurement, or of as much of it as can be followed.

    Raises:
        ContinuationError: nothing can be.
    """
    while True:
        try:
            return work(measurement)
        except ContinuationError as error:
            measurement = error.before(measurement)
