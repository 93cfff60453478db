"""What the fiducials would show: a sparse matrix that takes nodal displacements to fiducial displacements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from bcid.base import compat
from bcid.base.errors import Problems
from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.body import Body
from bcid.forms.mesh.closest import closest_on_triangles
from bcid.scene.parts import Vector

Array = NDArray[np.float64]
_INSIDE = 1e-9


@dataclass(frozen=True)
class Attachment:
    """Where a fiducial is fixed to the mesh: a cell, the nearest point in it, and how far the fiducial was from it (m)."""

    cell: int
    point: Array
    distance: float


def attach(
    mesh: BodyMesh, positions: Mapping[str, Vector], limit: float, source: str = "scene"
) -> dict[str, Attachment]:
    """Attach fiducials to the rest state of a mesh by the closest point.

    Args:
        mesh: the body.
        positions: stress-free positions by name, m.
        limit: the largest distance allowed, m.
        source: file named in messages.

    Raises:
        InputError: naming every fiducial that is further away.
    """
    problems = Problems(f"fiducials of {source}")
    result = {}
    corners = mesh.points[mesh.cells]
    inverses = np.asarray(np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)), dtype=float)
    for name, position in positions.items():
        found = _closest(mesh, corners[:, 0], inverses, np.array(position, dtype=float))
        if found.distance > limit:
            place = " ".join(f"{x * 1e3:.4g}" for x in position)
            near = " ".join(f"{x * 1e3:.4g}" for x in found.point)
            text = f"fiducial {name} at {place} mm lies {found.distance * 1e3:.3g} mm outside the body (closest point {near} mm); "
            problems.add(source, text + f"allowed are {limit * 1e3:.3g} mm: move it, or raise attach_within")
        result[name] = found
    problems.raise_if_any()
    return result


def points_of(fiducials: Mapping[str, Vector], members: Mapping[str, Sequence[Vector]]) -> dict[str, Vector]:
    """All points that fiducials are the mean of, by names for messages."""
    found: dict[str, Vector] = {}
    for name, place in fiducials.items():
        own = members.get(name, (place,))
        found |= {name: own[0]} if len(own) == 1 else {f"{name} ({k + 1})": one for k, one in enumerate(own)}
    return found


def _means(counts: Sequence[int]) -> csr_matrix:
    """From points to the means of groups of them, shape (groups, points)."""
    rows = np.repeat(np.arange(len(counts)), counts)
    weights = 1 / np.array(counts, dtype=float)[rows]
    return csr_matrix((weights, (rows, np.arange(len(rows)))), (len(counts), len(rows)))


def _closest(mesh: BodyMesh, corners: Array, inverses: Array, position: Array) -> Attachment:
    weights = _weights(corners, inverses, position)
    depth = weights.min(axis=1)
    cell = int(depth.argmax())
    if depth[cell] >= -_INSIDE:
        return Attachment(cell, position, 0.0)
    triangles = mesh.boundary
    candidates = closest_on_triangles(mesh.points[triangles], position)
    best = int(np.linalg.norm(candidates - position, axis=1).argmin())
    point = candidates[best]
    shared = np.isin(mesh.cells, triangles[best]).sum(axis=1)
    return Attachment(int(np.flatnonzero(shared == 3)[0]), point, float(np.linalg.norm(point - position)))


def _barycentric(corners: Array, position: Array) -> Array:
    """Barycentric coordinates of a point in many tetrahedra (n, 4, 3), shape (n, 4)."""
    inverses = np.asarray(np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)), dtype=float)
    return _weights(corners[:, 0], inverses, position)


def _weights(first: Array, inverses: Array, position: Array) -> Array:
    """The same from the first corner (n, 3) and the inverse of the edges (n, 3, 3)."""
    rest = np.matmul(inverses, (position - first)[:, :, None])[:, :, 0]
    return np.column_stack([1 - rest.sum(axis=1), rest])


class Observer:
    """Predicts fiducial positions from the state of a body. Building one and `positions` are collective.

    Args:
        body: the body.
        fiducials: stress-free positions by name, m; predictions keep this order.
        limit: largest distance from the body, m.
        source: file named in messages.
        members: of fiducials that are the mean of several points, the stress-free positions of those, m.

    Attributes:
        rest: stress-free positions, shape (fiducials, 3), m.
        matrix: this rank's part, shape (fiducials, nodes); the parts of all ranks add up.
        slopes: the same for the derivatives along x, y and z, 1/m.
        distances: how far each fiducial was from the mesh, m.
    """

    def __init__(
        self,
        body: Body,
        fiducials: Mapping[str, Vector],
        limit: float,
        source: str = "scene",
        members: Mapping[str, Sequence[Vector]] | None = None,
    ) -> None:
        self.body = body
        self.rest = np.array(list(fiducials.values()), dtype=float).reshape(-1, 3)
        groups = [(members or {}).get(name, (place,)) for name, place in fiducials.items()]
        attachments = list(attach(body.mesh, points_of(fiducials, members or {}), limit, source).values())
        mean = _means([len(group) for group in groups])
        self.distances = mean @ np.array([a.distance for a in attachments])
        matrix, slopes = self._build(attachments)
        self.matrix, self.slopes = csr_matrix(mean @ matrix), [csr_matrix(mean @ slope) for slope in slopes]
        covered = body.comm.allreduce(np.asarray(self.matrix.sum(axis=1)).ravel())
        if not np.allclose(covered, 1.0):
            raise AssertionError("a fiducial is attached to no cell, or to several")

    def _build(self, attachments: list[Attachment]) -> tuple[csr_matrix, list[csr_matrix]]:
        body = self.body
        topology = body.domain.topology
        local = np.asarray(topology.original_cell_index)[: topology.index_map(3).size_local]
        here = {int(original): i for i, original in enumerate(local)}
        geometry = np.asarray(compat.geometry_dofmap(body.domain))
        rows, columns, values, slopes = [], [], [], []
        for i, attachment in enumerate(attachments):
            cell = here.get(attachment.cell)
            if cell is None:
                continue
            corners = body.domain.geometry.x[geometry[cell]][None]
            reference = _barycentric(corners, attachment.point)[:, 1:]
            table = body.displacement_space.element.basix_element.tabulate(1, reference)[:, 0, :, 0]
            edges = corners[0, 1:] - corners[0, 0]
            nodes = body.displacement_space.dofmap.cell_dofs(cell)
            rows += [i] * len(nodes)
            columns += list(nodes)
            values += list(table[0])
            slopes.append(np.linalg.solve(edges, table[1:]))
        shape = len(attachments), len(body.nodes)
        along = np.hstack(slopes) if slopes else np.zeros((3, 0))
        return csr_matrix((values, (rows, columns)), shape), [csr_matrix((v, (rows, columns)), shape) for v in along]

    def of_unknowns(self) -> csr_matrix:
        """From unknowns to movements of the fiducials, shape (3 * fiducials, unknowns), of a body that is not shared over ranks."""
        columns = self.matrix.tocoo()
        dofs = self.body.displacement_dofs.reshape(-1, 3)
        rows = (3 * columns.row[:, None] + np.arange(3)).ravel()
        shape = 3 * len(self.rest), self.body.unknowns
        return csr_matrix((np.repeat(columns.data, 3), (rows, dofs[columns.col].ravel())), shape)

    def gradients(self, displacement: Array) -> Array:
        """Deformation gradients at the fiducials, shape (fiducials, 3, 3), of a body that is not shared over ranks."""
        return np.eye(3) + np.stack([slope @ displacement for slope in self.slopes], axis=-1)

    def positions(self, displacement: Array) -> Array:
        """Predicted positions, shape (fiducials, 3), m, the same on every rank, from this rank's `displacement` (nodes, 3)."""
        moved = self.matrix @ displacement
        if self.body.comm.size > 1:
            moved = self.body.comm.allreduce(moved)
        return self.rest + moved
