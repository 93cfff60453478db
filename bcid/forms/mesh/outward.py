"""Outward normals of facets of tetrahedra."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Corners of the facet opposite to each corner of a tetrahedron.
_FACETS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def outward_areas(corners: Array, facets: NDArray[np.integer]) -> Array:
    """Outward normals of one facet of each of some tetrahedra, as long as its area, shape (k, 3), m^2.

    Args:
        corners: of the tetrahedra, shape (k, 4, 3), m.
        facets: number of the corner opposite to the facet, shape (k,).
    """
    each = np.arange(len(facets))
    a, b, c = np.moveaxis(corners[each[:, None], _FACETS[facets]], 1, 0)
    areas = np.cross(b - a, c - a) / 2
    outward = np.sign(np.einsum("ki,ki->k", areas, a - corners[each, facets]))
    return np.asarray(areas * outward[:, None])
