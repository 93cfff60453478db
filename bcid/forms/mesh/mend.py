"""Small defects of a surface are mended, and said; what cannot be mended is refused with counts. For the child process alone.

The order matters: nodes are joined before edges are counted, triangles are turned before holes are gone around, and what
crosses itself is looked for last, on what will be meshed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from bcid.base.errors import InputError
from bcid.forms.mesh.body_mesh import triple
from bcid.forms.mesh.closest import Neighbourhood
from bcid.forms.mesh.parts_of_surface import one_body, owners, sides
from bcid.forms.mesh.surface_file import TriangleSurface

# Nodes closer than this part of the size are the same.
_JOINED = 1e-6
# A surface with more triangles is not taken: finding where it crosses itself takes minutes.
_MOST_TRIANGLES = 2_000_000
Array = NDArray[np.float64]

# Triangles that are looked at together, which bounds the memory that pairs take.
_TOGETHER = 5000
# A side that ends this near to a triangle, as a part of its length, touches it.
_TOUCHES = 1e-6
# A hole that is broader than this part of the body is not closed: nobody knows what the body is like there.
_SMALL = 0.1
_REMEDY = "close it (MeshLab: 'Close Holes'; Blender: Mesh > Fill), or scan the body from that side as well"


def mended(surface: TriangleSurface) -> TriangleSurface:
    """One closed surface that looks outward, with what was mended in its notes; cavities look inward.

    Raises:
        InputError: it is open, branched, crosses itself, has one side only, or is several bodies; with counts, and what to do.
    """
    if len(surface.triangles) > _MOST_TRIANGLES:
        raise InputError(
            f"has {len(surface.triangles)} triangles, more than {_MOST_TRIANGLES:,}; simplify the surface first"
        )
    surface = _without_doubles(_joined(surface))
    _refuse_branches(surface)
    turned = one_body(closed(_alike(surface)))
    turned = _with_turned_note(surface, turned)
    refuse_crossings(turned)
    return turned


def _joined(surface: TriangleSurface) -> TriangleSurface:
    """Nodes at the same place made one; in formats that share nodes that is a defect, and said."""
    used, triangles = np.unique(surface.triangles, return_inverse=True)
    points, triangles = surface.points[used], triangles.reshape(-1, 3)
    lost = int((~np.isfinite(points)).any(axis=1).sum())
    if lost:
        raise InputError(
            f"{lost} of its {len(points)} points have coordinates that are not finite; export it once more"
        )
    same = cKDTree(points).query_pairs(_JOINED * float(np.linalg.norm(np.ptp(points, axis=0))), output_type="ndarray")
    graph = coo_matrix((np.ones(len(same)), same.reshape(-1, 2).T), shape=(len(points),) * 2)
    count, number = connected_components(graph, directed=False)
    first = np.unique(number, return_index=True)[1]
    notes = surface.notes
    if surface.shared and count < len(points):
        notes = (*notes, f"{len(points) - count} points stood at the place of others and were joined with them")
    return replace(surface, points=points[first], triangles=number[triangles].astype(np.int64), notes=notes)


def _without_doubles(surface: TriangleSurface) -> TriangleSurface:
    """Without triangles that have less than three nodes or area, and those that stand there twice."""
    ordered = np.sort(surface.triangles, axis=1)
    flat = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
    kept = np.zeros(len(ordered), dtype=bool)
    kept[np.unique(ordered, axis=0, return_index=True)[1]] = True
    notes = surface.notes
    if flat.any():
        notes = (*notes, f"{int(flat.sum())} triangles without area were left out")
    if (~kept & ~flat).any():
        notes = (*notes, f"{int((~kept & ~flat).sum())} triangles that stood there twice were left out")
    kept &= ~flat
    if not kept.any():
        raise InputError("none of its triangles has an area: it is no surface; export it once more")
    return replace(
        surface,
        triangles=surface.triangles[kept],
        fields={name: values[kept] for name, values in surface.fields.items()},
        notes=notes,
    )


def _refuse_branches(surface: TriangleSurface) -> None:
    edges, _, count = owners(surface.triangles)
    many = np.flatnonzero(count > 2)
    if len(many):
        where = triple(surface.points[edges[many[0]]].mean(axis=0))
        raise InputError(
            f"{len(many)} edges belong to more than two triangles, the first at {where} in the unit of the file: the surface "
            "branches, or parts touch along edges; take inner walls out and keep parts apart (MeshLab: 'Repair non Manifold "
            "Edges'; Blender: Select > All by Trait > Non Manifold)"
        )


def _alike(surface: TriangleSurface) -> TriangleSurface:
    """With triangles turned like their neighbours; whether inward or outward, is told by the volume of each part later.

    Every triangle stands in a graph twice, as it is and turned; neighbours are joined in the ways that go together. A part of
    two sides falls apart into two components there, one with one side only does not.
    """
    triangles = surface.triangles
    pairs, against = _neighbours(triangles)
    count = len(triangles)
    here, there = pairs.T
    start = np.concatenate([here, here + count])
    end = np.concatenate([np.where(against, there + count, there), np.where(against, there, there + count)])
    graph = coo_matrix((np.ones(len(start)), (start, end)), shape=(2 * count,) * 2)
    side = connected_components(graph, directed=False)[1].reshape(2, count)
    if (side[0] == side[1]).any():
        raise InputError(
            "has one side only, as a Moebius strip: there is no inside; take out the part that joins its two sides"
        )
    return _turned(surface, side[0] > side[1])


def _neighbours(triangles: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Pairs of triangles with a common edge, (pairs, 2), and whether both run along it the same way, as none should."""
    _, number, count = owners(triangles)
    ends = sides(triangles)
    order = np.argsort(number, kind="stable")
    first = np.concatenate([[0], np.cumsum(count)[:-1]])[count == 2]
    one, other = order[first], order[first + 1]
    return np.c_[one // 3, other // 3], ends[one, 0] == ends[other, 0]


def _turned(surface: TriangleSurface, which: NDArray[np.bool_]) -> TriangleSurface:
    triangles = surface.triangles.copy()
    triangles[which] = triangles[which][:, ::-1]
    fields = {name: np.where(_wide(which, values), values[:, ::-1], values) for name, values in surface.fields.items()}
    return replace(surface, triangles=triangles, fields=fields)


def _wide(which: NDArray[np.bool_], values: NDArray[np.float64]) -> NDArray[np.bool_]:
    return which.reshape(-1, *[1] * (values.ndim - 1))


def _with_turned_note(before: TriangleSurface, after: TriangleSurface) -> TriangleSurface:
    """How many triangles look another way than in the file; those of holes and of parts that were left out do not count."""
    was = {_turn(row) for row in before.triangles}
    now = [_turn(row) for row in after.triangles]
    known = {tuple(sorted(row)) for row in was}
    turned = sum(row not in was and tuple(sorted(row)) in known for row in now)
    if not turned:
        return after
    text = f"{turned} of {len(before.triangles)} triangles looked the wrong way and were turned"
    return replace(after, notes=(*after.notes, text))


def _turn(row: NDArray[np.int64]) -> tuple[int, ...]:
    """A triangle from its lowest node on, in its sense."""
    return tuple(map(int, np.roll(row, -int(row.argmin()))))


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
