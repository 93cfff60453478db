"""The parts that a surface falls into: one body with cavities is meant, loose bits are left out, several bodies are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from bcid.base.errors import InputError
from bcid.forms.mesh.surface_file import TriangleSurface

# A part with less than this of the largest one's volume is a loose bit.
_BIT = 1e-3
Numbers = NDArray[np.int64]


def one_body(surface: TriangleSurface) -> TriangleSurface:
    """The largest part, looking outward, and cavities in it, looking inward.

    Raises:
        InputError: the surface has no volume, or other parts of some size lie apart.
    """
    part = part_of_each(surface.triangles)
    volume = np.bincount(part, weights=_cones(surface))
    largest = int(np.abs(volume).argmax())
    spread = float(np.linalg.norm(np.ptp(surface.points, axis=0)))
    if not abs(volume[largest]) > 1e-9 * spread**3:
        raise InputError("encloses no volume: it is a sheet and no body; thicken it, or scan the body from all sides")
    bits = np.abs(volume) < _BIT * abs(volume[largest])
    others = [i for i in range(len(volume)) if i != largest and not bits[i]]
    cavities = [i for i in others if _inside(surface, part == largest, part == i)]
    apart = [i for i in others if i not in cavities]
    if apart:
        sizes = ", ".join(f"{abs(volume[i]) / abs(volume).sum():.2g}" for i in (largest, *apart))
        raise InputError(
            f"falls into {len(apart) + 1} bodies (parts of the volume: {sizes}): a scene has one; keep one of them, or join them "
            "(Blender: Boolean > Union)"
        )
    turned = (volume < 0)[part] ^ np.isin(part, cavities)
    kept = ~bits[part]
    notes = list(surface.notes)
    if bits.any():
        notes.append(f"{int(bits.sum())} loose bit(s) with less than {_BIT:g} of the volume were left out")
    if cavities:
        notes.append(f"{len(cavities)} cavity or cavities inside are kept")
    triangles = np.where(turned[:, None], surface.triangles[:, ::-1], surface.triangles)[kept]
    fields = {
        name: np.where(turned.reshape(-1, *[1] * (values.ndim - 1)), values[:, ::-1], values)[kept]
        for name, values in surface.fields.items()
    }
    return replace(surface, triangles=triangles, fields=fields, notes=tuple(notes))


def _cones(surface: TriangleSurface) -> NDArray[np.float64]:
    """Signed volumes between triangles and the middle of the surface, shape (k,)."""
    a, b, c = (surface.points[surface.triangles[:, i]] - surface.points.mean(axis=0) for i in range(3))
    return np.asarray(np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)


def enclosed(surface: TriangleSurface) -> float:
    """Volume that a closed surface encloses, in the unit of the file."""
    return float(_cones(surface).sum())


def _inside(surface: TriangleSurface, outer: NDArray[np.bool_], inner: NDArray[np.bool_]) -> bool:
    """Whether a part lies within another: by the solid angle under which it is seen (van Oosterom, Strackee 1983)."""
    place = surface.points[surface.triangles[inner][0, 0]]
    a, b, c = (surface.points[surface.triangles[outer][:, i]] - place for i in range(3))
    la, lb, lc = (np.linalg.norm(one, axis=1) for one in (a, b, c))
    dots = [np.einsum("ij,ij->i", p, q) * r for p, q, r in ((a, b, lc), (b, c, la), (c, a, lb))]
    angle = 2 * np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), la * lb * lc + sum(dots))
    return bool(abs(angle.sum()) > 2 * np.pi)


def sides(triangles: Numbers) -> Numbers:
    """The three sides of each triangle (k, 3) as it runs along them, shape (3 k, 2)."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)


def owners(triangles: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Edges (e, 2), lower node first; the edge of each side, shape (3 k,); and the number of triangles at each edge, (e,)."""
    edges, number, count = np.unique(np.sort(sides(triangles), axis=1), axis=0, return_inverse=True, return_counts=True)
    return edges, number.ravel(), count


def part_of_each(triangles: Numbers) -> Numbers:
    """Number of the part, connected by edges, that each triangle (k, 3) belongs to, shape (k,)."""
    number = owners(triangles)[1]
    order = np.argsort(number, kind="stable")
    same = number[order[1:]] == number[order[:-1]]
    one, other = order[:-1][same] // 3, order[1:][same] // 3
    graph = coo_matrix((np.ones(len(one)), (one, other)), shape=(len(triangles),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
