"""Quadrature points of a body, in its volume or on its boundary, and what fields are there: integrals without compiling a form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property

import basix
import numpy as np
from dolfinx import mesh as dmesh
from numpy.typing import NDArray

from bcid.base import compat
from bcid.forms.mesh.body import Body, outward_areas
from bcid.scene import Region

Array = NDArray[np.float64]
_CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class QuadraturePoints:
    """Points of the cells or of the outer facets of a body that is private to the process.

    Attributes:
        places: rest positions, shape (q, 3), m.
        weights: volume or area that each stands for, shape (q,), m^3 or m^2.
        normals: outward normals at rest, shape (q, 3); zero in the volume.
        nodes: nodes of the cell that each is in, shape (q, k).
        shapes: values of their shape functions, shape (q, k).
        slopes: gradients of them, shape (q, k, 3), 1/m.
        facets: local number of the outer facet that each is on, shape (q,); -1 in the volume.
    """

    places: Array
    weights: Array
    normals: Array
    nodes: NDArray[np.int64]
    shapes: Array
    slopes: Array
    facets: NDArray[np.int64]

    @classmethod
    def volume(cls, body: Body, degree: int) -> QuadraturePoints:
        """Those of all cells, exact for polynomials of this degree."""
        reference, weights = basix.make_quadrature(basix.CellType.tetrahedron, degree)
        cells = np.arange(body.domain.topology.index_map(3).size_local)
        geometry = _Geometry(body)
        count, each = len(cells), len(weights)
        measure = np.abs(np.linalg.det(geometry.jacobian))
        at = np.repeat(cells, each)
        return cls(
            geometry.places(cells, reference).reshape(-1, 3),
            (measure[:, None] * weights).ravel(),
            np.zeros((count * each, 3)),
            geometry.nodes[at],
            np.tile(geometry.tabulated(reference)[0], (count, 1)),
            geometry.slopes(cells, reference),
            np.full(count * each, -1),
        )

    @classmethod
    def boundary(cls, body: Body, degree: int) -> QuadraturePoints:
        """Those of all outer facets."""
        flat, weights = basix.make_quadrature(basix.CellType.triangle, degree)
        geometry, topology = _Geometry(body), body.domain.topology
        topology.create_connectivity(2, 3)
        topology.create_connectivity(3, 2)
        outer = np.asarray(dmesh.exterior_facet_indices(topology), dtype=np.int64)
        cells = np.array([topology.connectivity(2, 3).links(f)[0] for f in outer], dtype=np.int64)
        to_facet = topology.connectivity(3, 2)
        sides = np.array(
            [int(np.flatnonzero(to_facet.links(c) == f)[0]) for c, f in zip(cells, outer, strict=True)], dtype=np.int64
        )
        parts = [_of_side(geometry, cells[sides == s], outer[sides == s], s, flat, weights) for s in range(4)]
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def within(self, centre: Array, radius: float) -> NDArray[np.bool_]:
        """Which of the points are no further from a place (3,), m, than a radius, m; shape (q,)."""
        return np.asarray(np.linalg.norm(self.places - centre, axis=1) <= radius)

    def spot(self, centre: Array, radius: float) -> Array:
        """Gaussian about a place (3,), m, with this standard deviation, m; shape (q,)."""
        away = self.places - centre
        return np.asarray(np.exp(-np.einsum("qi,qi->q", away, away) / (2 * radius**2)))

    def some(self, chosen: NDArray[np.bool_]) -> QuadraturePoints:
        """Some of the points, (q,)."""
        return QuadraturePoints(*(getattr(self, part.name)[chosen] for part in fields(self)))

    def values(self, nodal: Array) -> Array:
        """Nodal vectors (nodes, 3, ...) at the points, shape (q, 3, ...)."""
        return np.asarray(np.einsum("qk,qk...->q...", self.shapes, nodal[self.nodes]))

    def gradients(self, nodal: Array) -> Array:
        """Their gradients d(vector_a)/dX_B, shape (q, 3, 3, ...): component, direction."""
        return np.asarray(np.einsum("qkB,qka...->qaB...", self.slopes, nodal[self.nodes]))

    def on(self, body: Body, regions: Mapping[str, Region]) -> dict[str, NDArray[np.bool_]]:
        """Which of the points lie on named surfaces, each (q,); what is no surface has no points."""
        found = {}
        for name, region in regions.items():
            entities = body.mesh.select(region, name)
            if entities.shape[1] == 3:
                found[name] = np.isin(self.facets, body.local_entities(entities))
        return found


class _Geometry:
    """Affine tetrahedra of a body: where reference points are, and shape functions there."""

    def __init__(self, body: Body) -> None:
        geometry = np.asarray(compat.geometry_dofmap(body.domain))
        self.corners = np.asarray(body.domain.geometry.x)[geometry]
        self.jacobian = np.swapaxes(self.corners[:, 1:] - self.corners[:, :1], 1, 2)
        self.nodes = np.asarray(body.displacement_space.dofmap.list, dtype=np.int64)
        self._element = body.displacement_space.element.basix_element

    @cached_property
    def inverse(self) -> Array:
        """Of the Jacobian, shape (cells, 3, 3)."""
        return np.asarray(np.linalg.inv(self.jacobian))

    def places(self, cells: NDArray[np.int64], reference: Array) -> Array:
        """Reference points (r, 3) of cells in space, shape (cells, r, 3)."""
        return np.asarray(self.corners[cells, :1] + np.einsum("cij,rj->cri", self.jacobian[cells], reference))

    def tabulated(self, reference: Array) -> Array:
        """Shape functions and their derivatives, shape (4, r, k)."""
        return np.asarray(self._element.tabulate(1, reference)[..., 0])

    def slopes(self, cells: NDArray[np.int64], reference: Array) -> Array:
        """Gradients of the shape functions, shape (cells * r, k, 3), 1/m."""
        table = self.tabulated(reference)[1:]
        found = np.einsum("jrk,cji->crki", table, self.inverse[cells])
        return np.asarray(found.reshape(-1, table.shape[2], 3))


def _of_side(
    geometry: _Geometry, cells: NDArray[np.int64], facets: NDArray[np.int64], side: int, flat: Array, weights: Array
) -> tuple[NDArray, ...]:
    """Columns of `QuadraturePoints` on the facets opposite to corner `side` of some cells."""
    corners = np.delete(_CORNERS, side, axis=0)
    reference = corners[0] + flat @ (corners[1:] - corners[0])
    areas = outward_areas(geometry.corners[cells], np.full(len(cells), side))
    size = np.linalg.norm(areas, axis=1)
    normals = areas / np.maximum(size, 1e-300)[:, None]
    each = len(weights)
    return (
        geometry.places(cells, reference).reshape(-1, 3),
        (2 * size[:, None] * weights).ravel(),
        np.repeat(normals, each, axis=0),
        geometry.nodes[np.repeat(cells, each)],
        np.tile(geometry.tabulated(reference)[0], (len(cells), 1)),
        geometry.slopes(cells, reference),
        np.repeat(facets, each),
    )
