"""Known dead loads: how a force on a named place is shared among its nodes."""

from __future__ import annotations

from functools import cache

import basix
import basix.ufl
import numpy as np
from numpy.typing import NDArray

from bcid.forms.mesh.body import Body
from bcid.scene import Region

Array = NDArray[np.float64]


def nodal_weights(body: Body, region: Region, what: str) -> Array:
    """Share of a uniformly spread force that each displacement node carries; collective.

    The integral of the shape functions over the place (surface, line or point) divided by its measure: the shares of
    all ranks add up to one. At degree 2 a flat triangle puts everything on its edge middles, a line 1/6, 4/6, 1/6 on
    its three nodes.

    Returns:
        shape (nodes,), zero on ghosts.
    """
    entities = body.mesh.select(region, what)
    dimension = entities.shape[1] - 1
    measures = _measures(body.mesh.points, entities)
    table: dict[tuple[float, ...], float] = {}
    for nodes, share in zip(entities, measures / measures.sum(), strict=True):
        for place, part in _shares(body.mesh.points[nodes], body.degree, dimension):
            key = _key(place, body.mesh.size)
            table[key] = table.get(key, 0.0) + share * part
    owned = body.displacement_space.dofmap.index_map.size_local
    weights = np.zeros(len(body.nodes))
    for i, node in enumerate(body.nodes[:owned]):
        weights[i] = table.get(_key(node, body.mesh.size), 0.0)
    return weights


def _key(place: Array, size: float) -> tuple[float, ...]:
    return tuple(np.round(place / size, 9) + 0.0)


def _measures(points: Array, entities: NDArray[np.int64]) -> Array:
    corners = points[entities]
    if entities.shape[1] == 1:
        return np.ones(len(entities))
    if entities.shape[1] == 2:
        return np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


def _shares(corners: Array, degree: int, dimension: int) -> list[tuple[Array, float]]:
    """Places of the nodes of one entity and their shares."""
    if dimension == 0:
        return [(corners[0], 1.0)]
    places, shares = _of_reference(degree, dimension)
    return list(zip(corners[0] + places @ (corners[1:] - corners[0]), shares, strict=True))


@cache
def _of_reference(degree: int, dimension: int) -> tuple[Array, list[float]]:
    """Nodes of the reference line or triangle, (k, dimension), and the means of their shape functions."""
    cell = (basix.CellType.interval, basix.CellType.triangle)[dimension - 1]
    element = basix.ufl.element("Lagrange", cell.name, degree).basix_element
    points, weights = basix.make_quadrature(cell, degree)
    means = weights @ element.tabulate(0, points)[0, :, :, 0] / weights.sum()
    return np.asarray(element.points), [float(mean) for mean in means]
