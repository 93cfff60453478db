"""Elements of every shape and order as linear tetrahedra, triangles, lines and points.

Second and higher orders are taken by their corners. Every quadrilateral is cut through its node of the lowest number, whichever
cell looks at it, so that neighbours agree; a cell is the cones from its own lowest node over the faces that do not have it.
Source: J. Dompierre, P. Labbe, M.-G. Vallet, R. Camarero, How to subdivide pyramids, prisms, and hexahedra into tetrahedra,
8th International Meshing Roundtable, 1999.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.forms.mesh.body_mesh import Cells, Points, volumes

# Names by dimension and number of corners, and the faces of cells, in the order of VTK and gmsh.
_NAMES = {(3, 4): "tetrahedra", (3, 5): "pyramids", (3, 6): "wedges", (3, 8): "hexahedra"}
_FACES: dict[int, tuple[tuple[int, ...], ...]] = {
    5: ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    6: ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    8: ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
# A tetrahedron of a cell with less than this part of the cell's mean is taken for turned.
_TURNED = -1e-9


@dataclass(frozen=True)
class Block:
    """Elements of one kind: dimension, nodes (elements, nodes of each), and how many of these, the first, are corners."""

    dimension: int
    nodes: Cells
    corners: int

    @property
    def linear(self) -> Cells:
        """The corners alone, shape (elements, corners)."""
        return self.nodes[:, : self.corners].astype(np.int64)


def as_tetrahedra(points: Points, blocks: Iterable[Block]) -> tuple[Cells, list[str]]:
    """Tetrahedra (cells, 4) of the solid elements among blocks, and what was done to them, in sentences.

    Raises:
        InputError: cells that are turned inside out, or so distorted that they have no inside.
    """
    solid = [block for block in blocks if block.dimension == 3 and len(block.nodes)]
    cells = [block.linear if block.corners == 4 else _cut(points, block) for block in solid]
    notes = [
        f"{len(block.nodes)} {_NAMES[3, block.corners]} are cut into {len(tetrahedra)} tetrahedra"
        for block, tetrahedra in zip(solid, cells, strict=True)
        if block.corners != 4
    ]
    if any(block.nodes.shape[1] > block.corners for block in solid):
        notes.append("elements of second or higher order are taken by their corners: curved edges become straight")
    return np.vstack([*cells, np.zeros((0, 4), dtype=np.int64)]), notes


def as_simplices(blocks: Iterable[Block]) -> Cells | None:
    """Triangles (k, 3), lines (k, 2) or points (k, 1): of the elements with the highest dimension below 3; None without any."""
    flat = [block for block in blocks if block.dimension < 3 and len(block.nodes)]
    if not flat:
        return None
    highest = max(block.dimension for block in flat)
    parts = [part for block in flat if block.dimension == highest for part in triangles(block.linear)]
    return np.unique(np.vstack(parts), axis=0)


def triangles(polygons: Cells) -> list[Cells]:
    """Polygons (k, corners) cut through their node of lowest number; lines and points as they are."""
    corners = polygons.shape[1]
    if corners < 4:
        return [polygons]
    turn = (polygons.argmin(axis=1)[:, None] + np.arange(corners)) % corners
    turned = np.take_along_axis(polygons, turn, axis=1)
    return [turned[:, [0, i, i + 1]] for i in range(1, corners - 1)]


def _cut(points: Points, block: Block) -> Cells:
    cells = block.linear
    lowest = cells.argmin(axis=1)
    parts, owners = [], []
    for corner in range(block.corners):
        mine = np.flatnonzero(lowest == corner)
        for face in _FACES[block.corners]:
            if corner in face:
                continue
            for triangle in triangles(cells[mine][:, face]):
                parts.append(np.c_[cells[mine, corner], triangle])
                owners.append(mine)
    tetrahedra, owner = np.vstack(parts), np.concatenate(owners)
    # Cells with an edge or face that is drawn together to a point, as Abaqus has them, have fewer tetrahedra.
    sound = _distinct(tetrahedra)
    _refuse_turned(points, tetrahedra[sound], owner[sound], block)
    return tetrahedra[sound]


def _distinct(tetrahedra: Cells) -> NDArray[np.bool_]:
    ordered = np.sort(tetrahedra, axis=1)
    return np.asarray((ordered[:, 1:] != ordered[:, :-1]).all(axis=1))


def _refuse_turned(points: Points, tetrahedra: Cells, owner: Cells, block: Block) -> None:
    """All tetrahedra have the same sign where cells have an inside; which, depends on who numbered the corners."""
    if not np.isfinite(points[tetrahedra]).all():
        return
    sizes = volumes(points, tetrahedra)
    sizes = sizes if sizes.sum() >= 0 else -sizes
    turned = np.unique(owner[sizes < _TURNED * np.abs(sizes).mean()])
    if len(turned):
        raise InputError(
            f"{len(turned)} of {len(block.nodes)} {_NAMES[3, block.corners]} are turned inside out or have no inside, the first "
            f"is number {turned[0]}; mend them, or mesh the body with tetrahedra"
        )
