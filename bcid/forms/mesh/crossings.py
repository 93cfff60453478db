"""Where a surface crosses itself. For the child process alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.forms.mesh.body_mesh import triple
from bcid.forms.mesh.closest import Neighbourhood
from bcid.forms.mesh.surface_file import TriangleSurface

Array = NDArray[np.float64]

# Triangles that are looked at together, which bounds the memory that pairs take.
_TOGETHER = 5000
# A side that ends this near to a triangle, as a part of its length, touches it.
_TOUCHES = 1e-6


def refuse_crossings(surface: TriangleSurface) -> None:
    """Refuse a surface whose triangles go through others.

    Raises:
        InputError: with the number of triangles, and where the first is.
    """
    corners = surface.points[surface.triangles]
    near = Neighbourhood(corners)
    crossing: set[int] = set()
    for begin in range(0, len(corners), _TOGETHER):
        mine = np.arange(begin, min(begin + _TOGETHER, len(corners)))
        at, other = near.pairs(near.middle[mine], near.radius[mine])
        one = mine[at]
        apart = (surface.triangles[one][:, :, None] != surface.triangles[other][:, None, :]).all(axis=(1, 2))
        one, other = one[apart], other[apart]
        through = _pierces(corners[one], corners[other])
        crossing |= set(one[through].tolist()) | set(other[through].tolist())
    if crossing:
        where = triple(corners[min(crossing)].mean(axis=0))
        raise InputError(
            f"crosses itself: {len(crossing)} triangles go through others, the first at {where} in the unit of the file; "
            "remove them and close the holes (MeshLab: 'Select Self Intersecting Faces'), or remesh the surface (Blender: "
            "Remesh > Voxel)"
        )


def _pierces(one: Array, other: Array) -> NDArray[np.bool_]:
    """Whether a side of a triangle goes through the inside of another, for pairs (n, 3, 3); after Moeller and Trumbore 1997."""
    found = np.zeros(len(one), dtype=bool)
    edge1, edge2 = other[:, 1] - other[:, 0], other[:, 2] - other[:, 0]
    for i in range(3):
        start, way = one[:, i], one[:, (i + 1) % 3] - one[:, i]
        across = np.cross(way, edge2)
        scale = np.einsum("ij,ij->i", edge1, across)
        flat = np.abs(scale) <= 1e-12 * np.linalg.norm(edge1, axis=1) * np.linalg.norm(across, axis=1)
        safe = np.where(flat, 1.0, scale)
        offset = start - other[:, 0]
        u = np.einsum("ij,ij->i", offset, across) / safe
        turned = np.cross(offset, edge1)
        v = np.einsum("ij,ij->i", way, turned) / safe
        t = np.einsum("ij,ij->i", edge2, turned) / safe
        inside = (u > _TOUCHES) & (v > _TOUCHES) & (u + v < 1 - _TOUCHES) & (t > _TOUCHES) & (t < 1 - _TOUCHES)
        found |= inside & ~flat
    return found
