"""Meshes that meshio reads, with the fields on their boundary. For the child process alone."""

from __future__ import annotations

import re
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError
from bcid.forms.mesh.body_mesh import BodyMesh, Cells, Points
from bcid.forms.mesh.fields import field_arrays, of_nodes
from bcid.forms.mesh.solid_cells import Block, as_simplices, as_tetrahedra

Arrays = dict[str, Any]
# Dimension and corners by the beginning of meshio's names, as "hexahedron20".
_FAMILIES = {
    "vertex": (0, 1),
    "line": (1, 2),
    "triangle": (2, 3),
    "quad": (2, 4),
    "tetra": (3, 4),
    "pyramid": (3, 5),
    "wedge": (3, 6),
    "hexahedron": (3, 8),
}


def with_meshio(source: Path) -> Arrays:
    """Read a foreign mesh; its cell sets and gmsh-like tags become groups, its point data fields on the boundary."""
    mesh = read_meshio(source)
    points = in_space(mesh.points)
    blocks = [_block(kind.type, kind.data) for kind in mesh.cells]
    cells, notes = as_tetrahedra(points, blocks)
    flat = None if len(cells) else as_simplices(block for block in blocks if block.dimension == 2)
    if not len(cells) and flat is None:
        kinds = ", ".join(dict.fromkeys(kind.type for kind in mesh.cells)) or "none"
        raise RuntimeError(
            f"holds no linear tetrahedra, and no cells that can be cut into some (cell types: {kinds}); a surface is "
            "meshed when it is an STL, PLY or OBJ file"
        )
    arrays: Arrays = {"points": points, "cells": cells, "notes": np.array(notes, dtype=str)}
    if flat is not None:
        arrays["flat"] = flat
    for name, sets in mesh.cell_sets.items():
        parts = [
            Block(b.dimension, b.nodes[np.asarray(rows, dtype=int)], b.corners)
            for b, rows in zip(blocks, sets, strict=True)
            if rows is not None
        ]
        found = as_simplices(parts)
        if found is not None:
            arrays[f"group:{name}"] = found
        inside, _ = as_tetrahedra(points, parts)
        if len(inside):
            arrays[f"part:{name}"] = inside
    return arrays | _on_boundary(points, cells, mesh.point_data)


def read_meshio(source: Path) -> Any:
    """What meshio makes of a file."""
    import meshio

    try:
        # It prints what it has to say, and ends the process.
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            return meshio.read(source)
    except SystemExit:
        raise InputError(f"meshio does not know the format '{source.suffix}', or the file is damaged") from None


def in_space(points: Points) -> Points:
    """Points with three coordinates, whatever dimension they have, shape (nodes, 3)."""
    found = np.zeros((len(points), 3))
    found[:, : points.shape[1]] = points
    return found


def _block(kind: str, nodes: Cells) -> Block:
    name = re.match(r"[a-z]*", kind)
    if name is None or name.group() not in _FAMILIES:
        raise RuntimeError(f"holds elements of type {kind}; bcid needs tetrahedra")
    dimension, corners = _FAMILIES[name.group()]
    return Block(dimension, np.asarray(nodes), corners)


def _on_boundary(points: Points, cells: Cells, data: dict[str, Any]) -> Arrays:
    """Fields of nodes as `bcid.forms.mesh.fields` wants them, on the triangles of the boundary."""
    triangles = BodyMesh(points, cells).boundary if data and cells.max() < len(points) else cells[:0, :3]
    return field_arrays(points[triangles], {name: of_nodes(values, triangles) for name, values in data.items()})
