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
from bcid.forms.mesh.crossings import refuse_crossings
from bcid.forms.mesh.holes import closed
from bcid.forms.mesh.parts_of_surface import one_body
from bcid.forms.mesh.sides import owners, sides
from bcid.forms.mesh.surface_file import TriangleSurface

# Nodes closer than this part of the size are the same.
_JOINED = 1e-6
# A surface with more triangles is not taken: finding where it crosses itself takes minutes.
_MOST_TRIANGLES = 2_000_000


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
