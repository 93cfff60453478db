"""Gaussian bumps spread over the body, which carry what is unknown: a smooth force, and a smooth growth."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from bcid.forms import compiled
from bcid.forms.forward import Forward

Array = NDArray[np.float64]
# An unknown force is carried by so many bumps, and so is what grows.
BUMPS = 16
# What begins at one place does so at one of so many; and what is missing lies at one.
SPOTS = 48


def bumps(forward: Forward, count: int) -> tuple[Array, Array]:
    """Bumps that are as wide as they are apart: their middles, (bumps, 3), m, and weights at the nodes, (nodes, bumps), m^3."""
    body = forward.body
    space = fem.functionspace(body.domain, ("Lagrange", body.degree))
    volume = fem.assemble_vector(compiled.form(ufl.TestFunction(space) * ufl.dx)).array
    centres, width = _spread(body.nodes, count)
    return centres, _values(body.nodes, centres, width) * volume[:, None]


def growth_bumps(forward: Forward) -> Array:
    """The same bumps as growths of lengths, one at the middle of each: their values in every cell, (cells, BUMPS).

    What grows loads the body by stresses (an eigenstrain; Mura, Micromechanics of Defects in Solids, 1987, chapter 1). They have
    no sum, and act where the surface is free as well: no smooth force inside stands for them.
    """
    body = forward.body
    middles = fem.functionspace(body.domain, ("DG", 0)).tabulate_dof_coordinates()
    return _values(middles, *_spread(body.nodes, BUMPS))


def _spread(nodes: Array, count: int) -> tuple[Array, float]:
    """Middles of bumps (bumps, 3), and their width, m."""
    centres = farthest_point_sample(nodes, count)
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2) + np.diag(np.full(len(centres), np.inf))
    return centres, float(np.median(apart.min(axis=1)))


def _values(points: Array, centres: Array, width: float) -> Array:
    """Of each bump at points, (points, bumps)."""
    return np.exp(-0.5 * (np.linalg.norm(points[:, None] - centres[None], axis=2) / width) ** 2)


def farthest_point_sample(points: Array, count: int) -> Array:
    """Points far from each other: each the farthest from those before it."""
    chosen = [int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.asarray(points[chosen])


def force_unit(forward: Forward) -> float:
    """Shear modulus per size of the body, N/m^3: what the density of an unknown force is measured in, beside a growth of one."""
    size = float(np.linalg.norm(np.ptp(forward.mesh.points, axis=0)))
    model = forward.model
    return float(model.law.shear(model.law.complete(model.values))) / size
