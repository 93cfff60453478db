"""A number that is known at many places of a surface, as a field over it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyvista as pv

Array = NDArray[np.float64]


def coloured(moved: pv.PolyData, places: Array, values: Array) -> pv.PolyData:
    """A surface with the "value" at its nodes: means of places nearby, NaN where there is none, in smaller triangles than it has.

    A place counts by a Gaussian of its distance, as wide as places are apart.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(places)
    apart = float(np.median(tree.query(places, k=2)[0][:, 1]))
    edge = float(np.sqrt(moved.area / max(moved.n_cells, 1)))
    fine = moved.triangulate()
    for _ in range(max(0, min(3, round(np.log2(max(2 * edge / max(apart, 1e-9), 1.0)))))):
        fine = fine.subdivide(1, "linear")
    distance, near = tree.query(fine.points, k=min(8, len(places)), distance_upper_bound=2 * apart)
    weights = np.where(np.isfinite(distance), np.exp(-0.5 * (distance / apart) ** 2), 0.0)
    known = np.append(values, 0.0)[near]
    total = weights.sum(axis=1)
    fine.point_data["value"] = np.where(total > 0, (weights * known).sum(axis=1) / np.maximum(total, 1e-300), np.nan)
    return fine
