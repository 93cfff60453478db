"""Measured points as pictures show them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def completed(measured: Array, predicted: Array) -> Array:
    """Measured positions (..., 3); coordinates that were not measured beside others of a point are as predicted, for pictures."""
    seen = np.isfinite(measured)
    return np.where(~seen & seen.any(axis=-1, keepdims=True), predicted, measured)
