"""Holes of a surface: small ones are closed, larger ones are refused. For the child process alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.forms.mesh.body_mesh import triple
from bcid.forms.mesh.sides import owners, sides
from bcid.forms.mesh.surface_file import TriangleSurface

# A hole that is broader than this part of the body is not closed: nobody knows what the body is like there.
_SMALL = 0.1
_REMEDY = "close it (MeshLab: 'Close Holes'; Blender: Mesh > Fill), or scan the body from that side as well"


def closed(surface: TriangleSurface) -> TriangleSurface:
    """The surface, its triangles alike, with small holes closed by a fan around the middle of their rim; fields are nan there.

    Raises:
        InputError: a hole is larger than a tenth of the body, or holes touch.
    """
    rims = _rims(surface)
    if not rims:
        return surface
    broad = [_breadth(surface.points[rim]) for rim in rims]
    size = _breadth(surface.points)
    largest = int(np.argmax(broad))
    if broad[largest] > _SMALL * size:
        where = triple(surface.points[rims[largest]].mean(axis=0))
        text = f"is open: {len(rims)} hole(s) with {sum(map(len, rims))} edges, the largest {broad[largest]:.4g} across at {where}"
        raise InputError(f"{text}, in the unit of the file, of a body of {size:.4g}; {_REMEDY}")
    points, triangles = [surface.points], [surface.triangles]
    for number, rim in enumerate(rims):
        middle = len(surface.points) + number
        points.append(surface.points[rim].mean(axis=0, keepdims=True))
        triangles.append(np.c_[rim, np.roll(rim, -1), np.full(len(rim), middle)])
    added = sum(map(len, rims))
    fields = {name: _blank_beyond(values, added) for name, values in surface.fields.items()}
    note = f"{len(rims)} hole(s) were closed, the largest {broad[largest] / size:.2g} of the body's size across"
    return replace(
        surface,
        points=np.vstack(points),
        triangles=np.vstack(triangles),
        fields=fields,
        notes=(*surface.notes, note),
    )


def _breadth(points: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _blank_beyond(values: NDArray[np.float64], added: int) -> NDArray[np.float64]:
    return np.concatenate([values.astype(float), np.full((added, *values.shape[1:]), np.nan)])


def _rims(surface: TriangleSurface) -> list[NDArray[np.int64]]:
    """Nodes around each hole, in the sense that the triangles in it will have."""
    _, number, count = owners(surface.triangles)
    lone = sides(surface.triangles)[count[number] == 1]
    following = {int(b): int(a) for a, b in lone}
    if len(following) < len(lone):
        where = triple(surface.points[lone[0]].mean(axis=0))
        text = f"is open: {len(lone)} edges have a triangle on one side only, and holes touch, near {where}"
        raise InputError(f"{text} in the unit of the file; {_REMEDY}")
    rims = []
    while following:
        rim = [next(iter(following))]
        while following[rim[-1]] != rim[0]:
            rim.append(following[rim[-1]])
        rims.append(np.array(rim))
        for node in rim:
            del following[node]
    return rims
