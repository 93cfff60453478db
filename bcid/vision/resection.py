"""Where a camera stands, and what it is, from points in space that it saw: the direct linear transformation.

Coordinates are first moved and scaled (Hartley & Zisserman, Multiple View Geometry, 7.1), for without that rounding and noise
count too much.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.vision.calibrations.projections import decompose
from bcid.vision.corners import Corners

Array = NDArray[np.float64]

# Points are solid, not flat, from this ratio of their smallest extent to their largest: a transformation can be found then.
_SOLID = 0.05


def relief(points: Array) -> float:
    """Smallest over largest extent (singular value) of points (n, 3): 0 for a plane."""
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(sizes[2] / sizes[0]) if sizes[0] > 0 else 0.0


def is_solid(points: Array) -> bool:
    """Whether one view of points (n, 3) tells what the camera is."""
    return len(points) >= 6 and points.shape[1:] == (3,) and bool(np.isfinite(points).all()) and relief(points) > _SOLID


def resect(points: Array, pixels: Array) -> Array:
    """Projection matrix (3, 4) from points (n, 3) and pixels (n, 2); at least six, not in a plane."""
    space, image = _normal(points), _normal(pixels)
    x = np.column_stack([points, np.ones(len(points))]) @ space.T
    u = np.column_stack([pixels, np.ones(len(pixels))]) @ image.T
    nought = np.zeros_like(x)
    system = np.vstack([np.hstack([x, nought, -u[:, :1] * x]), np.hstack([nought, x, -u[:, 1:2] * x])])
    found = np.linalg.svd(system)[2][-1].reshape(3, 4)
    return np.asarray(np.linalg.solve(image, found @ space))


def focal_lengths(points: Array, pixels: Array) -> Array | None:
    """fx and fy, px, of the camera that saw points at pixels; None where they tell none."""
    parts = decompose(resect(points, pixels))
    return None if parts is None else np.diag(parts[0])[:2]


def is_mirrored(corners: Corners) -> bool:
    """Whether both images show a solid object as a mirror would: the cameras would have to look away from it."""
    if not is_solid(corners.board):
        return False
    middle = corners.board.mean(axis=0)
    parts = [decompose(resect(corners.board, pixels)) for pixels in (corners.left, corners.right)]
    return all(part is not None and float(part[1][2] @ middle + part[2][2]) < 0 for part in parts)


def _normal(points: Array) -> Array:
    """The map of homogeneous points to ones with their middle at the origin, at a distance of the root of their dimension."""
    count = points.shape[1]
    middle = points.mean(axis=0)
    scale = np.sqrt(count) / max(float(np.linalg.norm(points - middle, axis=1).mean()), 1e-300)
    made = np.eye(count + 1)
    made[:count, :count] *= scale
    made[:count, count] = -scale * middle
    return made
