"""How much of each cell lies in a region of the body.

A mesh that is not fitted to an outline has cells that it cuts. Their share is counted on a lattice of points inside of them: what
a region weighs changes by no more than the lattice shows when the mesh moves.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, nearest
from bcid.forms.mesh.body_mesh import BodyMesh, triple, volumes
from bcid.scene.parts import BodyRegion, Polygon

Array = NDArray[np.float64]
# Points along an edge of a cell: 56 in all.
_POINTS = 6


def share(mesh: BodyMesh, region: BodyRegion, what: str) -> Array:
    """Part of each cell that lies in a region, shape (cells,).

    Raises:
        InputError: a physical volume that the mesh does not have, or a region that holds nothing of the body, or all of it.
    """
    inside = np.ones((len(mesh.cells), len(_LATTICE)), dtype=bool)
    if region.volumes:
        inside &= _of_volumes(mesh, region.volumes, what)[:, None]
    if region.box or region.sphere or region.outline or region.label is not None:
        points = np.einsum("pk,ckx->cpx", _LATTICE, mesh.points[mesh.cells])
        if region.box:
            lower, upper = region.box.lower, region.box.upper
            inside &= ((points >= np.array(lower)) & (points <= np.array(upper))).all(axis=2)
        if region.sphere:
            inside &= np.linalg.norm(points - np.array(region.sphere.centre), axis=2) <= region.sphere.radius
        if region.outline:
            inside &= _enclosed(points, region.outline)
        if region.label is not None and mesh.voxels is not None:
            inside &= mesh.voxels.at(points) == region.label
    found = np.asarray(inside.mean(axis=1))
    part = float(found @ volumes(mesh.points, mesh.cells)) / mesh.volume
    if not 0 < part < 1:
        low, high = (triple(corner * 1e3) for corner in (mesh.points.min(axis=0), mesh.points.max(axis=0)))
        how = "nothing of the body" if part == 0 else "the whole body"
        raise InputError(f"{what}: holds {how}, which spans {low} to {high} mm")
    return found


def _lattice() -> Array:
    """Barycentric coordinates of evenly spread points inside a tetrahedron, shape (points, 4)."""
    rows = [(*some, _POINTS - 1 - sum(some)) for some in product(range(_POINTS), repeat=3) if sum(some) < _POINTS]
    return (np.array(rows) + 0.25) / _POINTS


_LATTICE = _lattice()


def _of_volumes(mesh: BodyMesh, names: tuple[str, ...], what: str) -> NDArray[np.bool_]:
    """Which cells are of physical volumes, shape (cells,)."""
    for name in names:
        if name not in mesh.parts:
            raise InputError(f"{what}: the mesh has no physical volume '{name}'; {nearest(name, mesh.parts)}")
    wanted = np.vstack([mesh.parts[name] for name in names])
    rows = np.sort(np.vstack([mesh.cells, wanted]), axis=1)
    number = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    return np.isin(number[: len(mesh.cells)], number[len(mesh.cells) :])


def _enclosed(points: Array, outline: Polygon) -> NDArray[np.bool_]:
    """Which points (..., 3) lie inside a polygon, seen along its direction, by the crossings of a ray (even and odd).

    Source: M. Shimrat, Algorithm 112, Position of point relative to polygon, Comm. ACM 5 (1962).
    """
    along = np.array(outline.along)
    first = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    axes = np.array([first / np.linalg.norm(first), np.cross(along, first / np.linalg.norm(first))])
    flat, corners = points @ axes.T, np.array(outline.corners) @ axes.T
    inside = np.zeros(points.shape[:-1], dtype=bool)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        between = (ay > flat[..., 1]) != (by > flat[..., 1])
        if ay != by:
            inside ^= between & (flat[..., 0] < ax + (flat[..., 1] - ay) * (bx - ax) / (by - ay))
    return inside
