"""Sides of triangles, how many triangles have each edge, and which hang together by edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Numbers = NDArray[np.int64]


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
