"""Have a body and the places that a scene names on it the same unit of length?"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems
from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.closest import closest_on_triangles
from bcid.scene import Scene

Array = NDArray[np.float64]
# Factors by which coordinates are wrong when their unit is: mm for m, cm for mm, cm for m, inches for mm.
_SLIPS = (1000.0, 1e-3, 10.0, 0.1, 100.0, 1e-2, 25.4, 1 / 25.4)
# The centre of a grasp may be away from its facets by this part of the body's size: the middle of a curved area is not on it.
_AWAY = 0.25
# Another unit is named when it brings the places so much nearer to the body, and onto it, both in parts of its size.
_NEARER, _ON_IT = 5.0, 0.1


def check_length_unit(scene: Scene, mesh: BodyMesh, limit: float) -> None:
    """Refuse grasps whose centres are far from their facets, and markers off the body that another unit would put onto it.

    Args:
        scene: the scene.
        mesh: its body.
        limit: how far a marker may be from the body, m.

    Raises:
        InputError: with the unit that would mend it, if one does.
    """
    now = _distances(scene, mesh, 1.0)
    grasps = dict(zip(scene.grasps, now[len(scene.fiducials) :], strict=True))
    far = {name: part for name, part in grasps.items() if part > _AWAY}
    off = bool((now[: len(scene.fiducials)] * mesh.size > limit).any())
    if not far and not off:
        return
    hint = _other_unit(scene, mesh, now)
    if not far and not hint:
        return
    problems = Problems(f"scene {scene.source} and geometry {scene.geometry.name}")
    for name, part in far.items():
        problems.add(
            scene.source,
            f"grasps.{name}.centre: lies {part * mesh.size * 1e3:.4g} mm from the facets of this grasp, on a body of "
            f"{mesh.size * 1e3:.4g} mm; write the centre of the area, in the frame of the geometry",
        )
    if hint:
        problems.add(scene.source, hint)
    problems.raise_if_any()


def _other_unit(scene: Scene, mesh: BodyMesh, now: Array) -> str:
    """The slip nearest to none that would bring markers and grasps onto the body, in words."""
    found = {factor: _rms(_distances(scene, mesh, factor)) for factor in _SLIPS}
    good = [factor for factor in _SLIPS if found[factor] <= min(_ON_IT, _rms(now) / _NEARER)]
    if not good:
        return ""
    factor = min(good, key=lambda f: abs(math.log(f)))
    looks = f"{factor:.4g} times too large" if factor > 1 else f"{1 / factor:.4g} times too small"
    return (
        f"geometry.length_unit: the body looks {looks}: it is {mesh.size * 1e3:.4g} mm long; with another unit the markers and "
        "grasps would lie on it. Is the unit that of the coordinates in the file?"
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.minimum(values, 1e6) ** 2)))


def _distances(scene: Scene, mesh: BodyMesh, factor: float) -> Array:
    """Of fiducials to the boundary and of grasp centres to their facets, in parts of the size of a body smaller by a factor."""
    size = mesh.size / factor
    corners = mesh.points[mesh.boundary] / factor
    rest = [_nearest(corners, place) for place in scene.rest]
    centres = [
        float(
            np.linalg.norm(
                (mesh.points[mesh.select(grasp.region, name)] / factor).mean(axis=(0, 1)) - np.array(grasp.centre)
            )
        )
        for name, grasp in scene.grasps.items()
    ]
    return np.array([*rest, *centres]) / size


def _nearest(corners: NDArray[Any], place: Array) -> float:
    return float(np.linalg.norm(closest_on_triangles(corners, place) - place, axis=1).min())
