"""Balls that the body would run into: outside of it at rest, and reached by its surface as a model moves it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bcid.forms.force_bumps import farthest_point_sample
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
# Balls are tried before so many places of the surface, at these parts of the way that it comes there, and of these radii in sizes.
_PLACES = 24
_PARTS = (0.25, 0.6)
_RADII = (0.15, 0.6)
# A way of less than this part of the size meets nothing that is worth a ball.
_WAY = 0.01


def obstacle_candidates(state: State) -> list[dict[str, float]]:
    """Centre and radius (cx, cy, cz, radius, m) of each; collective, and the same on every rank."""
    mesh = state.predictor.forward(state.model).mesh
    corners = mesh.points[mesh.boundary]
    middles = corners.mean(axis=1)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
    ways = _ways(state, normals)
    coming = np.flatnonzero(ways > _WAY * mesh.size)
    if not len(coming):
        return []
    places = farthest_point_sample(middles[coming], _PLACES)
    chosen = coming[[int(np.argmin(np.linalg.norm(middles[coming] - place, axis=1))) for place in places]]
    found = []
    for at, part, radius in ((a, p, r * mesh.size) for a in chosen for p in _PARTS for r in _RADII):
        before = part * ways[at]
        centre = middles[at] + (before + radius) * normals[at]
        # At rest the body is clear of it.
        if np.linalg.norm(mesh.points - centre, axis=1).min() > radius + before / 2:
            found.append(dict(zip(("cx", "cy", "cz", "radius"), (*map(float, centre), radius), strict=True)))
    return found


def _ways(state: State, normals: Array) -> Array:
    """How far each outer facet comes along its normal at most, m, shape (facets,)."""
    predictor = state.predictor
    forward = predictor.forward(state.model)
    facets = forward.mesh.boundary
    ways = np.zeros(len(facets))
    for moved in _displacements(state):
        along = np.einsum("kna,ka->kn", moved[facets], normals)
        ways = np.maximum(ways, along.mean(axis=1))
    return np.asarray(np.max(predictor.comm.allgather(ways), axis=0))


def _displacements(state: State) -> Iterator[Array]:
    """Of the nodes of the mesh, (nodes, 3), m, in the frames that this rank has computed."""
    body = state.predictor.forward(state.model).body
    for part in state.prediction.parts.values():
        for unknowns in (part.states or {}).values():
            yield body.at_mesh_nodes(unknowns[body.displacement_dofs].reshape(-1, 3))
