"""Have a body and the places that a scene names on it the same unit of length?"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems
from bcid.base.units import unit_factor
from bcid.forms.mesh.body_mesh import BodyMesh
from bcid.forms.mesh.closest import closest_on_triangles
from bcid.scene import Scene

Array = NDArray[np.float64]
# Factors by which coordinates are wrong when one of these units is taken for another.
_UNITS = tuple(unit_factor(unit, like="m") for unit in ("m", "cm", "mm", "um", "in"))
_SLIPS = tuple(sorted({float(f"{a / b:.9g}") for a, b in permutations(_UNITS, 2)}))
# The centre of a grasp may be away from its facets by this part of the body's size: the middle of a curved area is not on it.
_AWAY = 0.25
# Another unit is named when it brings the places so much nearer to the body, and onto it, both in parts of its size.
_NEARER, _ON_IT = 5.0, 0.1
# Units that fit are as good as the best up to so many times its distances, and this part of the size more.
_AS_GOOD, _ALIKE = 1.5, 0.01
# The surface of a rough mesh may be away from the body's by this part of its size: its elements are as long.
ROUGH = 0.1


def fiducial_limit(scene: Scene, mesh: BodyMesh) -> float:
    """How far from the mesh a fiducial may be, m: the scene's `attach_within`, or 5 % of the body's size."""
    return 0.05 * mesh.size if scene.attach_within is None else scene.attach_within


def check_rough(scene: Scene, mesh: BodyMesh) -> None:
    """`check_length_unit` on a rough mesh, before a fine one is made: by the grasps that it shows, and not to within an element.

    Raises:
        InputError: the unit is another.
    """
    shown = {name: grasp for name, grasp in scene.grasps.items() if mesh.shows(grasp.region)}
    check_length_unit(replace(scene, grasps=shown), mesh, max(fiducial_limit(scene, mesh), ROUGH * mesh.size))


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
    """The slip that would bring markers and grasps onto the body, of those as good the nearest to none, in words."""
    found = {factor: _rms(_distances(scene, mesh, factor)) for factor in _SLIPS}
    good = [factor for factor in _SLIPS if found[factor] <= min(_ON_IT, _rms(now) / _NEARER)]
    if not good:
        return ""
    most = _AS_GOOD * min(found[factor] for factor in good) + _ALIKE
    factor = min((f for f in good if found[f] <= most), key=lambda f: abs(math.log(f)))
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
