"""Points that a depth camera would see of the surface of a simulated body."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.body_mesh import among
from bcid.measurement import Measurement
from bcid.measurement.cloud import Cloud, frames_of
from bcid.scene import Scene

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


def shown_facets(scene: Scene, mesh: BodyMesh, anchors: Iterable[str]) -> Numbers:
    """Triangles of the boundary that are not held, gripped or lain on, shape (k, 3)."""
    regions = {f"patch {name}": scene.patches[name] for name in anchors}
    regions |= {f"grasp {name}": grasp.region for name, grasp in scene.grasps.items()}
    if scene.support:
        regions[f"place {scene.support}"] = scene.places[scene.support]
    hidden = np.zeros(len(mesh.boundary), dtype=bool)
    for name, region in regions.items():
        hidden |= among(mesh.boundary, mesh.select(region, name))
    return mesh.boundary[~hidden]


def simulated_cloud(
    made: Measurement,
    mesh: BodyMesh,
    triangles: Numbers,
    displacement: Array,
    count: int,
    sigma: float,
    rng: np.random.Generator,
) -> Cloud:
    """`count` points in each frame of a measurement, other ones in each, anywhere on triangles (k, 3) of a mesh.

    Args:
        displacement: of the nodes of the mesh, shape (frames, nodes, 3), m.
        sigma: standard deviation of the white noise of every coordinate, m.
        rng: where points and noise come from.
    """
    a, b, c = (mesh.points[triangles[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    frames = len(displacement)
    chosen = rng.choice(len(triangles), (frames, count), p=areas / areas.sum())
    # Uniform over each triangle.
    root, along = np.sqrt(rng.random((frames, count))), rng.random((frames, count))
    weights = np.stack([1 - root, root * (1 - along), root * along], axis=-1)
    nodes = triangles[chosen]
    points = mesh.points[nodes] + displacement[np.arange(frames)[:, None, None], nodes]
    seen = np.einsum("fnk,fnka->fna", weights, points).reshape(-1, 3) + rng.normal(0.0, sigma, (frames * count, 3))
    return Cloud(seen, np.full(len(seen), np.nan), frames_of(made.data), np.repeat(np.arange(frames), count))
