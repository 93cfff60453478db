"""What the beads around a bead say of its motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.vision.layout import LEAST, axes

Array = NDArray[np.float64]

# Smoothing of the spline: none but what rounding asks for.
_SMOOTH = 1e-6


def neighbours(rest: Array, displacement: Array) -> Array:
    """What the others say of each bead's displacement, shape (beads, 3), m: a thin plate spline without the bead itself.

    Args:
        rest: places at rest, shape (beads, 3), m.
        displacement: shape (beads, 3), m; NaN where not known. With fewer than four others the result is NaN.
    """
    from scipy.interpolate import RBFInterpolator

    away = rest - rest.mean(axis=0)
    # Places in a plane or in a row have so many coordinates only.
    flat = away @ axes(rest).T / np.linalg.norm(away)
    known = np.asarray(np.isfinite(displacement).all(axis=1))
    said = np.full(displacement.shape, np.nan)
    for bead in range(len(rest)):
        others = known.copy()
        others[bead] = False
        if others.sum() >= max(LEAST, flat.shape[1] + 1):
            try:
                spline = RBFInterpolator(
                    flat[others], displacement[others], kernel="thin_plate_spline", smoothing=_SMOOTH
                )
                said[bead] = spline(flat[bead : bead + 1])[0]
            except np.linalg.LinAlgError:
                # Those that are left stand in a row.
                said[bead] = displacement[others].mean(axis=0)
    return said
