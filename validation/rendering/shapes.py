"""Triangles of what is drawn: the body with its sharp edges, a box, a rod with round ends."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from validation.rendering.shot import Shot
from validation.rendering.vectors import unit

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]

# Edges of the body sharper than this stay edges in its shading, deg.
_EDGE = 40.0


def shaded_body(shot: Shot) -> tuple[NDArray[np.int64], Triangles]:
    """Nodes (p,) that points of the drawn body belong to, several at sharp edges, and its triangles (m, 3), outward."""
    import pyvista as pv

    faces = np.column_stack([np.full(len(shot.triangles), 3), shot.triangles]).ravel()
    mesh = pv.PolyData(shot.points, faces)
    mesh.point_data["node"] = np.arange(len(shot.points))
    options = {"cell_normals": False, "consistent_normals": True, "auto_orient_normals": False}
    mesh = mesh.compute_normals(split_vertices=True, feature_angle=_EDGE, **options)
    triangles = np.array(mesh.faces.reshape(-1, 4)[:, 1:])
    node = np.array(mesh.point_data["node"])
    normals = normals_of(shot.points[node], triangles)
    near = np.argmin(np.linalg.norm(shot.points[node][None] - shot.beads[:, None], axis=-1), axis=1)
    outward = float(np.sum(normals[near] * shot.normals)) >= 0
    return node, triangles if outward else triangles[:, ::-1]


def normals_of(points: Array, triangles: Triangles) -> Array:
    """Unit normals (n, 3) at points (n, 3): the sum of the triangles' normals by area."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    area = np.cross(b - a, c - a)
    sums = [np.bincount(triangles.ravel(), np.repeat(area[:, i], 3), len(points)) for i in range(3)]
    return unit(np.column_stack(sums))


def box_mesh(count: int) -> tuple[Array, Array, Triangles]:
    """Points and outward normals (n, 3) and triangles (m, 3) of the unit cube, each face a grid: light varies over it."""
    points: list[Array] = []
    normals, triangles = [], []
    grid, faces = _grid(count, count)
    for axis in range(3):
        for side in (0, 1):
            triangles.append(faces + len(points) * len(grid))
            points.append(np.insert(grid, axis, side, axis=1))
            normals.append(np.tile(np.eye(3)[axis] * (2 * side - 1), (len(grid), 1)))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(triangles)


def rod_mesh() -> tuple[Array, Array, Triangles]:
    """A rod with round ends along z: place along the axis (n,), 0 to 1, unit normals (n, 3), triangles (m, 3)."""
    cap, long, sides = 6, 24, 24
    grid, faces = _grid(2 * cap + long, sides)
    latitudes = np.concatenate([np.linspace(-90, 0, cap + 1), np.zeros(long - 1), np.linspace(0, 90, cap + 1)])
    along = np.concatenate([np.zeros(cap), np.linspace(0, 1, long + 1), np.ones(cap)])
    latitude, turn = np.radians(np.repeat(latitudes, sides + 1)), 2 * math.pi * grid[:, 1]
    normals = np.column_stack([np.cos(latitude) * np.cos(turn), np.cos(latitude) * np.sin(turn), np.sin(latitude)])
    return np.repeat(along, sides + 1), normals, faces


def _grid(rows: int, columns: int) -> tuple[Array, Triangles]:
    """Points (n, 2) and triangles (m, 3) of a unit square of rows x columns cells."""
    a, b = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    corners = [first, first + columns + 1, first + columns + 2, first + 1]
    triangles = np.concatenate([np.column_stack([corners[i] for i in t]) for t in ((0, 1, 2), (0, 2, 3))])
    return np.column_stack([a.ravel(), b.ravel()]), triangles
