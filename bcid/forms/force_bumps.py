"""Gaussian bumps spread over the body, which carry a smooth force."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from bcid.forms import compiled
from bcid.forms.forward import Forward

Array = NDArray[np.float64]
# An unknown force is carried by so many bumps.
BUMPS = 16
# What begins at one place does so at one of so many; and what is missing lies at one.
SPOTS = 48


def bumps(forward: Forward, count: int) -> tuple[Array, Array]:
    """Bumps that are as wide as they are apart: their middles, (bumps, 3), m, and weights at the nodes, (nodes, bumps), m^3."""
    body = forward.body
    space = fem.functionspace(body.domain, ("Lagrange", body.degree))
    volume = fem.assemble_vector(compiled.form(ufl.TestFunction(space) * ufl.dx)).array
    nodes = body.nodes
    centres = scattered(nodes, count)
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2) + np.diag(np.full(len(centres), np.inf))
    width = float(np.median(apart.min(axis=1)))
    shapes = np.exp(-0.5 * (np.linalg.norm(nodes[:, None] - centres[None], axis=2) / width) ** 2)
    return centres, shapes * volume[:, None]


def scattered(points: Array, count: int) -> Array:
    """Points far from each other: each the farthest from those before it."""
    chosen = [int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.asarray(points[chosen])


def force_unit(forward: Forward) -> float:
    """Shear modulus per size of the body, N/m^3: what the density of an unknown force is measured in."""
    size = float(np.linalg.norm(np.ptp(forward.mesh.points, axis=0)))
    model = forward.model
    return float(model.law.shear(model.law.complete(model.values))) / size
