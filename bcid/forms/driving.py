"""Places that measured points drive: which points those are, how they move, and how well that is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError
from bcid.base.kriging import Kriging
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.mesh.closest import closest_triangles
from bcid.measurement import Measurement
from bcid.measurement.compared import halved_groups
from bcid.scene import Scene
from bcid.scene.parts import LEAST_POINTS, Driven

Array = NDArray[np.float64]
# Variance of the noise, as part of that of displacements, where gaps are filled.
_GAP_NOISE = 1e-4
# More points than these drive a place by the means of neighbours: costs grow with the third power.
_MOST_POINTS = 512


def driven_by_points(scene: Scene, measurement: Measurement, comm: Comm) -> tuple[Scene, Measurement]:
    """The scene with the points that drive its places, and the measurement with their motion; collective on `comm`.

    They are no fiducials any more: what drives the model is not compared with it.

    Raises:
        InputError: too few points drive a place, an axis of them was not measured, or no other fiducial is left.
    """
    return on_root(comm, lambda: _driven(scene, measurement)) if scene.driven else (scene, measurement)


def _driven(scene: Scene, measurement: Measurement) -> tuple[Scene, Measurement]:
    mesh = level_mesh(scene, scene.levels[0])
    found, moved, owners, used = {}, [], [], set[str]()
    for name, driven in scene.driven.items():
        markers = _markers(scene, measurement, mesh, name)
        known, own = _motion(scene, measurement, name, markers)
        found[name] = replace(known, markers=tuple(markers), near=driven.near)
        moved.append(own)
        owners += [name] * own.shape[1]
        used |= set(markers)
    left = [name for name in measurement.fiducial_names if name not in used]
    if not left:
        raise InputError(
            "driven: every fiducial that was measured drives a place; none is left to compare the model with"
        )
    data = measurement.data.sel(fiducial=left).assign_coords(driven=("point", owners))
    data["drive"] = (("frame", "point", "axis"), np.concatenate(moved, axis=1))
    return replace(scene, driven=found), replace(measurement, data=data)


def _markers(scene: Scene, measurement: Measurement, mesh: BodyMesh, name: str) -> list[str]:
    """The fiducials that drive a place, of those that were seen."""
    names = measurement.fiducial_names
    seen = np.flatnonzero(np.isfinite(measurement.positions).any(axis=(0, 2)))
    return driving_fiducials(scene, mesh, name, [names[k] for k in seen])


def driving_fiducials(scene: Scene, mesh: BodyMesh, name: str, among: Sequence[str]) -> list[str]:
    """Those of some fiducials that drive a place.

    Raises:
        InputError: they are too few.
    """
    driven, once = scene.driven[name], [one for one in among if one not in scene.surface]
    markers, what = [one for one in driven.markers if one in once], "of those that drive it are seen"
    if driven.near is not None:
        away = _distances(scene, mesh, name, np.array([scene.fiducials[one] for one in once]).reshape(-1, 3))
        markers = [one for one, distance in zip(once, away, strict=True) if distance <= driven.near]
        what = f"are within {driven.near * 1e3:g} mm of it"
        if len(markers) < LEAST_POINTS <= len(once):
            what += f" (the {LEAST_POINTS} nearest within {1e3 * np.sort(away)[LEAST_POINTS - 1]:.3g} mm)"
    if len(markers) < LEAST_POINTS:
        raise InputError(f"driven.{name}: {len(markers)} fiducials {what}; {LEAST_POINTS} or more are needed")
    return markers


def _distances(scene: Scene, mesh: BodyMesh, name: str, points: Array) -> Array:
    """How far points (n, 3) are from a place, shape (n,), m."""
    region = scene.grasps[name].region if name in scene.grasps else scene.places[name]
    entities = mesh.select(region, f"driven.{name}")
    if not len(points):
        return np.zeros(0)
    if entities.shape[1] < 3:
        return np.asarray(cKDTree(mesh.points[np.unique(entities)]).query(points)[0])
    triangles = mesh.points[entities]
    number, weights = closest_triangles(triangles, points)
    return np.asarray(np.linalg.norm((weights[:, :, None] * triangles[number]).sum(axis=1) - points, axis=1))


def _motion(scene: Scene, measurement: Measurement, name: str, markers: list[str]) -> tuple[Driven, Array]:
    """What is known of a place, and displacements (frames, points, 3), m, of its points.

    A point sits where the scene has it only as well as `markers` says: what moves between frames is taken as it is, what all
    frames have in common only as far as it is smooth.
    """
    driven = scene.driven[name]
    rest = np.array([scene.fiducials[one] for one in markers], dtype=float)
    columns, axes = [measurement.fiducial_names.index(one) for one in markers], list(driven.along)
    away = _filled(scene, measurement, name, rest, measurement.positions[:, columns] - rest)
    sigma = measurement.sigma(scene.noise_sigma)
    noise = None if sigma is None else float(np.sqrt(np.nanmean(sigma[:, columns][..., axes] ** 2)))
    since, firsts = np.zeros(away.shape), []
    for action in measurement.actions:
        firsts.append(away[action.frames[0]])
        since[action.frames] = away[action.frames] - firsts[-1]
    begun, placed = np.mean(firsts, axis=0), _placed(scene)
    if len(rest) > _MOST_POINTS:
        groups = halved_groups(rest, _MOST_POINTS)
        few = float(np.mean([1 / np.sqrt(len(group)) for group in groups]))
        rest, begun, since = (_means(values, groups) for values in (rest, begun, since))
        noise, placed = noise and noise * few, placed * few
    kriging = Kriging.of(rest, _fields(since, axes), noise)
    placed = float(np.hypot(placed, kriging.noise / np.sqrt(len(firsts))))
    at_rest = Kriging.of(rest, begun[:, axes], placed or None)
    smooth = at_rest.weights(rest)
    moved = since + smooth @ begun
    offset = float(np.sqrt(kriging.noise**2 + placed**2 * np.mean(np.sum(smooth**2, axis=1))))
    found = replace(
        driven,
        points=tuple((float(x), float(y), float(z)) for x, y, z in rest),
        length=kriging.length,
        ratio=kriging.ratio,
        scale=kriging.scale,
        offset=offset,
    )
    return found, moved


def _filled(scene: Scene, measurement: Measurement, name: str, rest: Array, away: Array) -> Array:
    """Displacements (frames, points, 3), m, with gaps filled from the points of the same frame; zero along axes that are free.

    Raises:
        InputError: an axis was not measured, or too few points are seen in a frame.
    """
    along, found = scene.driven[name].along, np.zeros(away.shape)
    for axis in along:
        values = away[..., axis]
        if not np.isfinite(values).any():
            others = ", ".join(f'"{"xyz"[other]}"' for other in along if other != axis)
            hint = f"write along = [{others}]" if others and name not in scene.grasps else "measure it"
            raise InputError(f"driven.{name}: {'xyz'[axis]} of its points was not measured; {hint}")
        for frame, row in enumerate(values):
            found[frame, :, axis] = row if np.isfinite(row).all() else _without_gaps(rest, row)
        short = np.flatnonzero(np.isfinite(values).sum(axis=1) < LEAST_POINTS)
        if len(short):
            data = measurement.data
            where = f"step {int(data['step'].values[short[0]])} of action {data['action'].values[short[0]]}"
            count = int(np.isfinite(values[short[0]]).sum())
            raise InputError(
                f"driven.{name}: in {where} {count} of its {len(rest)} points are seen along {'xyz'[axis]}; "
                f"{LEAST_POINTS} or more are needed in every frame: leave such frames out"
            )
    return found


def _without_gaps(rest: Array, values: Array) -> Array:
    """Values (points,) with what is missing interpolated from the others."""
    seen = np.isfinite(values)
    if seen.sum() < LEAST_POINTS:
        return values
    extent = max(float(np.linalg.norm(np.ptp(rest[seen], axis=0))), 1e-12)
    filled = values.copy()
    filled[~seen] = Kriging(rest[seen], extent, _GAP_NOISE, 1.0).weights(rest[~seen]) @ values[seen]
    return filled


def _means(values: Array, groups: Sequence[NDArray[np.int64]]) -> Array:
    """Of groups of points, of values (..., points, 3)."""
    return np.stack([values[..., group, :].mean(axis=-2) for group in groups], axis=-2)


def _placed(scene: Scene) -> float:
    """Standard deviation of where a fiducial sits on the body, m."""
    size = float(np.linalg.norm(np.ptp(scene.rest, axis=0)))
    return float(scene.uncertainty.of(size).markers or 0.0)


def _fields(moved: Array, axes: list[int]) -> Array:
    """Displacements (frames, points, 3) as fields of the points, (points, frames * axes)."""
    return np.asarray(np.moveaxis(moved[..., axes], 1, 0).reshape(moved.shape[1], -1))
