"""How near a body is to buckling: an eigenvalue of the tangent falls towards zero there.

The smallest eigenvalue along a path that was followed tells when the body becomes soft. It does not tell of a path that has
left the straight one already: on a mesh that is not symmetric it bends aside smoothly. For that, linear theory gives the
part of a motion at which the tangent would become singular, and the mode; whether there are two states at the end is then
seen by looking for the other one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from bcid.forms.solver.equilibrium import Equilibrium
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose
from bcid.scene.rotation import slerp

Array = NDArray[np.float64]
# Below this part of its value at rest another state may exist: which one is taken is for imperfections to choose.
NEAR_BUCKLING = 0.5
# Iterations at most, and the part by which an eigenvalue changes in the last; the direction in which a body will buckle need not be
# exact.
_SWEEPS, _SETTLED = 24, 1e-3
# Part of a motion in which the tangent changes in proportion to it; accuracy and restarts of the mode.
_SMALL, _ACCURATE, _RESTARTS = 0.01, 1e-2, 30
# Two states are different when a fiducial is this part of the body's size apart.
APART = 1e-3


def smallest_eigenvalue(equilibrium: Equilibrium, start: Array | None = None) -> tuple[float, Array]:
    """Smallest eigenvalue of the tangent at the present state, N/m, and its eigenvector, by inverse iteration; collective.

    Args:
        equilibrium: with what is held.
        start: eigenvector of a state near by, shape (unknowns,); at random by default.
    """
    vector = np.random.default_rng(0).normal(size=len(equilibrium.u.x.array)) if start is None else start.copy()
    vector[equilibrium.supports.prescribed] = 0.0
    size = np.inf
    if equilibrium.verify() is Status.LINEAR_SOLVER:
        return 0.0, vector / np.linalg.norm(vector)
    for _ in range(_SWEEPS):
        vector /= np.linalg.norm(vector)
        solved = equilibrium.factor.solve_block(vector[:, None])[:, 0]
        before, size, vector = size, 1 / float(vector @ solved), solved
        if abs(before - size) <= _SETTLED * size:
            break
    return size, vector / np.linalg.norm(vector)


@dataclass(frozen=True)
class Mode:
    """The way in which a body would buckle.

    Attributes:
        part: of the motion, at which it would; infinite: never.
        shape: change of all unknowns, with an energy of one half by the tangent at rest.
        dual: the tangent at rest times that: its product with a deflection is how much of the mode there is in it.
        begun: how much there would be at the end of the motion, if the body went on as it begins to.
    """

    part: float
    shape: Array
    dual: Array
    begun: float = 0.0


def linear_buckling(equilibrium: Equilibrium, rest: Array, start: Pose, end: Pose) -> Mode:
    """Where the tangent becomes singular between two poses, if it goes on changing as it begins to; one rank only.

    The eigenproblem K phi = x (K - K') phi / s of the tangents K at rest and K' at a small part s of the motion; x is the
    part at which the body buckles (Bathe, Finite Element Procedures, section 6.8.2).

    Args:
        equilibrium: with what is held; its state is changed.
        rest: state at `start`.
        start, end: poses.
    """
    never = Mode(math.inf, np.zeros_like(rest), np.zeros_like(rest))
    equilibrium.set_state(start, rest)
    if equilibrium.solve(_between(start, end, _SMALL)) is not Status.CONVERGED:
        return never
    equilibrium.verify()
    bent, little = equilibrium.tangent.copied(), equilibrium.u.x.array - rest
    equilibrium.set_state(start, rest)
    if equilibrium.verify() is not Status.CONVERGED:
        return never
    straight = equilibrium.tangent.copied()
    inverse = LinearOperator(straight.shape, lambda x: equilibrium.factor.solve_block(np.reshape(x, (-1, 1)))[:, 0])
    begin = np.random.default_rng(0).normal(size=len(rest))
    try:
        sizes, shapes = eigsh(
            (straight - bent) / _SMALL,
            1,
            straight,
            which="LA",
            Minv=inverse,
            v0=begin,
            tol=_ACCURATE,
            maxiter=_RESTARTS,
        )
    except ArpackNoConvergence:
        return never
    shape = shapes[:, 0]
    dual = straight @ shape
    return Mode(1 / sizes[0] if sizes[0] > 0 else math.inf, shape, dual, float(dual @ little) / _SMALL)


def _between(start: Pose, end: Pose, part: float) -> Pose:
    loads = {
        place: start.loads.get(place, 0.0) + part * (load - start.loads.get(place, 0.0))
        for place, load in end.loads.items()
    }
    moved = start.translation + part * (end.translation - start.translation)
    return replace(start, translation=moved, rotation=slerp(start.rotation, end.rotation, part), loads=loads)


def two_states(
    equilibrium: Equilibrium, fiducials: Callable[[], Array], mode: Mode, rest: Array, end: Pose, state: Array
) -> bool:
    """Whether there is another stable state at a pose, with the deflection along a mode reversed.

    Args:
        equilibrium: with what is held; its state is changed.
        fiducials: positions of the fiducials (fiducials, 3), m, in the present state.
        mode: see `linear_buckling`.
        rest: state at rest.
        end: the pose.
        state: the state that is known there.
    """
    equilibrium.set_state(end, state)
    known = fiducials()
    deflected = float(mode.dual @ (state - rest))
    if abs(deflected - mode.begun) * float(np.abs(mode.shape).max()) < APART * equilibrium.body.mesh.size:
        # It has gone no further than in proportion.
        return False
    other = stable_state(equilibrium, fiducials, end, state - 2 * deflected * mode.shape)
    return other is not None and bool(np.linalg.norm(other - known, axis=1).max() > APART * equilibrium.body.mesh.size)


def stable_state(equilibrium: Equilibrium, fiducials: Callable[[], Array], pose: Pose, start: Array) -> Array | None:
    """Fiducials (fiducials, 3), m, in the equilibrium that is found from a state; None if there is none, or it is not stable."""
    if equilibrium.solve(pose, start) is not Status.CONVERGED or equilibrium.verify() is not Status.CONVERGED:
        return None
    return fiducials()
