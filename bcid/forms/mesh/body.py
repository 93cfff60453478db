"""The body: one mesh level in DOLFINx, its displacement space, and the degrees of freedom of every named place."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import basix.ufl
import numpy as np
from dolfinx import default_scalar_type, fem, la
from dolfinx import mesh as dmesh
from numpy.typing import NDArray

from bcid.base import compat
from bcid.base.collective import Comm
from bcid.base.errors import InputError
from bcid.forms.mesh import BodyMesh
from bcid.scene import Region

Array = NDArray[np.float64]
# Corners of the facet opposite to each corner of a tetrahedron.
_FACETS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


class Body:
    """A meshed body with a displacement space (and a pressure space in the mixed formulation).

    Building one is collective on `comm`. With `comm` of one rank it is private to the process; otherwise the mesh is
    shared out.

    Args:
        comm: the communicator.
        mesh: the same arrays on every rank.
        degree: polynomial degree of the displacement.
        mixed: also carry a pressure, one degree lower (Taylor-Hood).

    Attributes:
        domain: the DOLFINx mesh.
        space: function space of the unknown (displacement, or displacement and pressure).
        displacement_space: space of the displacement alone.
        displacement_dofs: where the displacement stands in the unknown, shape (3 * nodes,), in the order of `nodes`.
    """

    def __init__(self, comm: Comm, mesh: BodyMesh, degree: int = 1, mixed: bool = False) -> None:
        if mixed and degree < 2:
            raise InputError("the mixed formulation needs degree 2 (Taylor-Hood); set degree = 2 on every level")
        self.comm = comm
        self.mesh = mesh
        self.degree = degree
        self.mixed = mixed
        self._axis_spaces: dict[int, Any] = {}
        element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,), dtype=np.float64)
        mine = comm.rank == 0
        cells = mesh.cells if mine else np.zeros((0, 4), dtype=np.int64)
        points = mesh.points if mine else np.zeros((0, 3))
        self.domain = compat.make_mesh(comm, cells, points, element)
        displacement = basix.ufl.element("Lagrange", "tetrahedron", degree, shape=(3,))
        if mixed:
            pressure = basix.ufl.element("Lagrange", "tetrahedron", degree - 1)
            self.space = fem.functionspace(self.domain, basix.ufl.mixed_element([displacement, pressure]))
            self.displacement_space, into = compat.collapsed(self.space.sub(0))
            self.displacement_dofs = into
        else:
            self.space = self.displacement_space = fem.functionspace(self.domain, displacement)
            self.displacement_dofs = np.arange(3 * len(self.nodes), dtype=np.int32)

    @property
    def quadrature_degree(self) -> int:
        """Exact for the energy of an affine deformation at degree 1; 3 and 5 keep the order of convergence at 2 and 3."""
        return {1: 0, 2: 3, 3: 5}[self.degree]

    def by_cell(self, values: NDArray[np.float64]) -> fem.Function:
        """A function with one value in each cell, from those of the mesh's cells in order; local."""
        found = fem.Function(fem.functionspace(self.domain, ("DG", 0)))
        dofs = found.function_space.dofmap.list.reshape(-1)
        found.x.array[dofs] = values[np.asarray(self.domain.topology.original_cell_index)[: len(dofs)]]
        return found

    @cached_property
    def unknowns(self) -> int:
        """Number of degrees of freedom over all ranks."""
        return int(self.space.dofmap.index_map.size_global * self.space.dofmap.index_map_bs)

    @cached_property
    def pressures(self) -> int:
        """How many of them are pressures."""
        displacement = self.displacement_space.dofmap
        return self.unknowns - int(displacement.index_map.size_global * displacement.index_map_bs)

    @cached_property
    def nodes(self) -> NDArray[np.float64]:
        """Rest positions of this rank's displacement nodes, ghosts included, shape (nodes, 3), m."""
        return self.displacement_space.tabulate_dof_coordinates()

    @cached_property
    def _node_numbers(self) -> NDArray[np.int64]:
        """Mesh array number of every local vertex."""
        geometry = np.asarray(compat.geometry_dofmap(self.domain))
        original = np.asarray(self.domain.geometry.input_global_indices)
        self.domain.topology.create_connectivity(3, 0)
        connectivity = self.domain.topology.connectivity(3, 0)
        vertices = connectivity.array.reshape(-1, 4)
        number = np.full(int(vertices.max(initial=-1)) + 1, -1, dtype=np.int64)
        number[vertices.ravel()] = original[geometry.ravel()]
        return number

    def at_mesh_nodes(self, values: NDArray[np.float64], space: Any = None) -> NDArray[np.float64]:
        """Values at this rank's nodes of a space, (nodes, ...), at those of `mesh`, the same on every rank; collective.

        The space is that of displacements by default.
        """
        dofmap = (space or self.displacement_space).dofmap
        geometry = np.asarray(compat.geometry_dofmap(self.domain))
        original = np.asarray(self.domain.geometry.input_global_indices)[geometry.ravel()]
        corners = np.asarray(dofmap.list)[:, :4].ravel()
        owned = corners < dofmap.index_map.size_local
        result = np.zeros((len(self.mesh.points), *values.shape[1:]))
        result[original[owned]] = values[corners[owned]]
        return np.asarray(self.comm.allreduce(result)) if self.comm.size > 1 else result

    def local_entities(self, entities: NDArray[np.int64]) -> NDArray[np.int32]:
        """This rank's numbers of mesh entities given by their nodes, shape (k, 3), (k, 2) or (k, 1)."""
        dimension = entities.shape[1] - 1
        topology = self.domain.topology
        topology.create_entities(dimension)
        topology.create_connectivity(dimension, 0)
        topology.create_connectivity(dimension, 3)
        connectivity = topology.connectivity(dimension, 0)
        here = np.sort(self._node_numbers[connectivity.array.reshape(-1, dimension + 1)], axis=1)
        wanted = np.sort(entities, axis=1)
        _, inverse = np.unique(np.vstack([here, wanted]), axis=0, return_inverse=True)
        inverse = inverse.ravel()
        return np.flatnonzero(np.isin(inverse[: len(here)], inverse[len(here) :])).astype(np.int32)

    def dirichlet(self, region: Region, what: str, value: Any = None, axis: int | None = None) -> Any:
        """A DOLFINx Dirichlet condition that holds a region, or one axis (0, 1, 2) of it; collective.

        `value` is a Function of the displacement space, or of one `axis_space`, None for zero.
        """
        entities = self.mesh.select(region, what)
        dimension, local = entities.shape[1] - 1, self.local_entities(entities)
        if not self.mixed and axis is None:
            dofs = fem.locate_dofs_topological(self.space, dimension, local)
            if value is None:
                return fem.dirichletbc(np.zeros(3, default_scalar_type), dofs, self.space)
            return fem.dirichletbc(value, dofs)
        part = self._displacement if axis is None else self._displacement.sub(axis)
        inner = self.displacement_space if axis is None else self.axis_space(axis)
        pairs = fem.locate_dofs_topological((part, inner), dimension, local)
        return fem.dirichletbc(fem.Function(inner) if value is None else value, pairs, part)

    @property
    def _displacement(self) -> Any:
        return self.space.sub(0) if self.mixed else self.space

    def axis_space(self, axis: int) -> Any:
        """The space of displacements along one axis (0, 1, 2); collective when it is first asked for."""
        if axis not in self._axis_spaces:
            self._axis_spaces[axis] = self._displacement.sub(axis).collapse()[0]
        return self._axis_spaces[axis]

    def facet_measure(self, regions: Sequence[Region], names: Sequence[str]) -> Any:
        """A surface measure in which ``measure(i + 1)`` is region i; regions may overlap, facets inside are left out."""
        import ufl

        sides = [(i + 1, self._sides(r, n)) for i, (r, n) in enumerate(zip(regions, names, strict=True))]
        metadata = {"quadrature_degree": 2 * self.degree}
        return ufl.Measure("ds", domain=self.domain, subdomain_data=sides, metadata=metadata)

    @property
    def nodal_rule(self) -> dict[str, Any]:
        """Metadata of a quadrature of a facet that takes the values at its nodes, all with one weight."""
        kind = basix.ElementFamily.P, basix.CellType.triangle, self.degree, basix.LagrangeVariant.gll_warped
        points = basix.create_element(*kind).points
        weights = (0.5 / len(points),) * len(points)
        # Tuples: how UFL tells forms apart is by the text of this.
        rule = tuple(map(tuple, points.tolist()))
        return {"quadrature_rule": "custom", "quadrature_points": rule, "quadrature_weights": weights}

    def normals(self, region: Region, name: str) -> Any:
        """Outward unit normals of a surface at its nodes at rest, a Function of the displacement space, zero elsewhere; collective.

        At an edge it is that of the facets about it, each by its area.
        """
        sides = self._sides(region, name).reshape(-1, 2)
        corners = np.asarray(self.domain.geometry.x)[np.asarray(compat.geometry_dofmap(self.domain))[sides[:, 0]]]
        areas = outward_areas(corners, sides[:, 1])
        found = fem.Function(self.displacement_space)
        values = found.x.array.reshape(-1, 3)
        element, dofmap = self.displacement_space.element.basix_element, np.asarray(self.displacement_space.dofmap.list)
        for side in range(4):
            here = sides[:, 1] == side
            nodes = dofmap[sides[here, 0]][:, element.entity_closure_dofs[2][side]]
            np.add.at(values, nodes, areas[here, None])
        found.x.scatter_reverse(la.InsertMode.add)
        found.x.scatter_forward()
        size = np.linalg.norm(values, axis=1)
        values /= np.where(size > 0, size, 1.0)[:, None]
        return found

    def _sides(self, region: Region, name: str) -> NDArray[np.int32]:
        """Outer facets of a region as DOLFINx integrates over them: cells, each followed by the number of the facet in it."""
        facets = self.local_entities(self.mesh.select(region, name))
        topology = self.domain.topology
        topology.create_connectivity(2, 3)
        topology.create_connectivity(3, 2)
        to_cell, to_facet = topology.connectivity(2, 3), topology.connectivity(3, 2)
        owned = topology.index_map(3).size_local
        pairs = []
        for facet in np.intersect1d(facets, dmesh.exterior_facet_indices(topology)):
            cell = int(to_cell.links(facet)[0])
            if cell < owned:
                pairs.append((cell, int(np.flatnonzero(to_facet.links(cell) == facet)[0])))
        return np.array(pairs, dtype=np.int32).ravel()


def outward_areas(corners: Array, facets: NDArray[np.integer]) -> Array:
    """Outward normals of one facet of each of some tetrahedra, as long as its area, shape (k, 3), m^2.

    Args:
        corners: of the tetrahedra, shape (k, 4, 3), m.
        facets: number of the corner opposite to the facet, shape (k,).
    """
    each = np.arange(len(facets))
    a, b, c = np.moveaxis(corners[each[:, None], _FACETS[facets]], 1, 0)
    areas = np.cross(b - a, c - a) / 2
    outward = np.sign(np.einsum("ki,ki->k", areas, a - corners[each, facets]))
    return np.asarray(areas * outward[:, None])
