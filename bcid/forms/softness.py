"""How near a body is to buckling: the smallest eigenvalue of the tangent falls towards zero there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.forms.solve import Equilibrium, Status

Array = NDArray[np.float64]
# Below this part of its value at rest another state may exist: which one is taken is for imperfections to choose.
SOFT = 0.5
# Iterations; the direction in which a body will buckle need not be exact.
_SWEEPS = 8


def softest(equilibrium: Equilibrium) -> tuple[float, Array]:
    """Smallest eigenvalue of the tangent at the present state, N/m, and its eigenvector, by inverse iteration; collective."""
    vector = np.random.default_rng(0).normal(size=len(equilibrium.u.x.array))
    vector[equilibrium.prescribed] = 0.0
    size = np.inf
    if equilibrium.verify() is Status.LINEAR_SOLVER:
        return 0.0, vector / np.linalg.norm(vector)
    for _ in range(_SWEEPS):
        vector /= np.linalg.norm(vector)
        solved = equilibrium.factor.solve_block(vector[:, None])[:, 0]
        size, vector = 1 / float(vector @ solved), solved
    return size, vector / np.linalg.norm(vector)
