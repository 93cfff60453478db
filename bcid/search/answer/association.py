"""Which points of a cloud belong to which surface mark, and what they say of it: that depends on where the surface is predicted.

The points around each mark give a plane, of which the distance to the mark counts and nothing along it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError
from bcid.base.units import percent, show
from bcid.forms.forward import Forward
from bcid.forms.mesh import level_mesh
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.forms.surface_marks import SurfaceMarks
from bcid.measurement import AXES, Measurement
from bcid.measurement.plane_fits import Pieces, Planes, fit_planes
from bcid.results.identification_words import SURFACE_MARK
from bcid.scene import Scene
from bcid.scene.parts import Vector

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]
# What names of surface marks begin with.
# The surface is predicted on a level with so many unknowns at most: an error of it shifts what is seen only to second order.
_UNKNOWNS = 15_000
_ACCURACY = Settings(rtol=1e-5)
# Where the middle of the points at rest is further from the surface than this part of the body's size they are not of it.
_APART = 0.25
# Points of a frame at rest that tell of a surface.
LEAST_POINTS = 40
# Where the body moves at least this part of the points must count that count at rest: of the others the answer knows nothing.
_KEPT = 0.5


@dataclass(frozen=True)
class _Above:
    """Points above the surface in all frames: frame, mark, height (m), place beside the mark (n, 2) (m), stated noise (m)."""

    frame: Numbers
    mark: Numbers
    height: Array
    beside: Array
    sigma: Array


class Association:
    """Associates the cloud of a measurement with the marks of a scene. Methods are collective on `comm`.

    Args:
        scene: without surface marks.
        measurement: with a cloud.
        comm: rank 0 does the work.

    Attributes:
        scene: with the surface marks as fiducials besides.

    Raises:
        InputError: the cloud does not show the body at rest.
    """

    def __init__(self, scene: Scene, measurement: Measurement, comm: Comm | None = None) -> None:
        self.comm, self.measurement = comm, measurement
        self.marks: SurfaceMarks = on_root(comm, lambda: _marks(scene, measurement))
        names = [f"{SURFACE_MARK} {number + 1}" for number in range(len(self.marks.middle))]
        taken = [name for name in names if name in scene.fiducials]
        if taken:
            raise InputError(f"fiducial '{taken[0]}' has the name of a surface mark; call it something else")
        places = _named(names, self.marks.rest)
        self._built: tuple[tuple[str, ...], Forward] | None = None
        self.scene = replace(scene, fiducials=scene.fiducials | places, surface=tuple(names))

    def about(self, scene: Scene, model: Model, anchors: Iterable[str], seen: Measurement | None = None) -> Measurement:
        """What the marks show with the points associated by the prediction of a model and set of anchors.

        Args:
            scene: the scene with marks, whose patches may have been divided since.
            model, anchors: what is predicted.
            seen: the measurement, or as much of it as is compared.
        """
        seen = self.measurement if seen is None else seen
        return on_root(self.comm, lambda: self._about(scene, model, frozenset(anchors), seen))

    def _about(self, scene: Scene, model: Model, anchors: frozenset[str], seen: Measurement) -> Measurement:
        surface = self._surface(scene, model, anchors, seen)
        points = self._above(seen, surface)
        frames, marks = len(surface), len(self.marks.middle)
        number = points.frame * marks + points.mark
        # The model may be wrong by as much as it moves the surface, and by what is seen at rest.
        moved = np.mean(np.sum((surface - self.marks.vertices) ** 2, axis=2), axis=1)
        allowed = np.repeat(np.sqrt(moved + self.marks.sag**2), marks)
        usual = np.tile(_usual(np.bincount(number, minlength=frames * marks).reshape(frames, marks)), frames)
        planes = fit_planes(Pieces(number, points.height, points.beside, points.sigma, allowed, usual))
        made = _with_marks(seen, self.scene.surface, *self._placed(surface, planes))
        cloud = seen.cloud
        assert cloud is not None
        counted = float(planes.counted.sum()) / max(int(np.sum(cloud.numbers(seen.data) >= 0)), 1)
        lost = _lost(seen, planes.counted.reshape(frames, marks).sum(axis=1))
        return replace(made, cloud=replace(cloud, noise=planes.noise, counted=counted), remarks=(*seen.remarks, *lost))

    def _surface(self, scene: Scene, model: Model, anchors: frozenset[str], seen: Measurement) -> Array:
        """Vertices of the surface in each frame (frames, v, 3), m; from where it cannot be followed they stay."""
        found = self._forward(scene, model).predict(anchors, seen.actions).positions
        for action in seen.actions:
            for before, frame in zip([-1, *action.frames[:-1]], action.frames, strict=True):
                if not np.isfinite(found[frame]).all():
                    found[frame] = self.marks.vertices if before < 0 else found[before]
        return found

    def _forward(self, scene: Scene, model: Model) -> Forward:
        """Predicts the vertices of the surface; the last one is kept for other anchors and values."""
        key = model.name, *scene.patches
        if self._built is None or self._built[0] != key:
            self.destroy()
            vertices = _named(map(str, range(len(self.marks.vertices))), self.marks.vertices)
            other = replace(scene, fiducials=vertices, members={}, surface=(), attach_within=self.marks.size)
            self._built = key, Forward(other, _level(other), None, model, _ACCURACY)
        self._built[1].set_model(model)
        return self._built[1]

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._built is not None:
            self._built[1].destroy()
            self._built = None

    def _above(self, seen: Measurement, surface: Array) -> _Above:
        cloud = self.measurement.cloud
        assert cloud is not None
        numbers, parts = cloud.numbers(seen.data), []
        order = np.argsort(numbers, kind="stable")
        bounds = np.searchsorted(numbers[order], np.arange(len(surface) + 1))
        for frame, vertices in enumerate(surface):
            here = order[bounds[frame] : bounds[frame + 1]]
            if len(here):
                parts.append(self._in_frame(frame, vertices, cloud.points[here], cloud.sigma[here]))
        return _Above(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(_Above)))

    def _in_frame(self, frame: int, vertices: Array, points: Array, sigma: Array) -> _Above:
        facets, marks = self.marks.facets(vertices), self.marks
        near, height = facets.above(points, marks.looked_at)
        mark = np.where(near >= 0, marks.mark[near], -1)
        used = np.flatnonzero((mark >= 0) & (np.abs(height) < marks.size))
        mark = mark[used]
        beside = marks.beside(facets, marks.axes(vertices), mark, points[used])
        return _Above(np.full(len(used), frame), mark, height[used], beside, sigma[used])

    def _slopes(self, axes: Array, middles: Array, planes: Planes) -> Array:
        """Slopes of the planes at the marks (frames, marks, 2), to which the offsets around each tell more than its own points."""
        shape = middles.shape[:2]
        offset, sigma = planes.offset.reshape(shape), planes.sigma.reshape(shape)
        own, precision = planes.slope.reshape(*shape, 2), np.linalg.inv(planes.slope_covariance).reshape(*shape, 2, 2)
        found = np.zeros((*shape, 2))
        for mark, near in enumerate(self.marks.neighbours):
            beside = np.einsum("fka,fna->fnk", axes[:, mark, :2], middles[:, near] - middles[:, mark, None])
            shapes = np.concatenate([np.ones((*beside.shape[:2], 1)), beside], axis=2)
            told = np.isfinite(offset[:, near])
            weights = np.where(told, sigma[:, near], np.inf) ** -2
            matrix = np.einsum("fn,fni,fnj->fij", weights, shapes, shapes)
            right = np.einsum("fn,fni,fn->fi", weights, shapes, np.where(told, offset[:, near], 0.0))
            matrix[:, 1:, 1:] += precision[:, mark]
            right[:, 1:] += np.einsum("fij,fj->fi", precision[:, mark], own[:, mark])
            found[:, mark] = (np.linalg.pinv(matrix, hermitian=True) @ right[..., None])[:, 1:, 0]
        return found

    def _placed(self, surface: Array, planes: Planes) -> tuple[Array, Array, Array]:
        """A point on the plane of each mark, its normal, (frames, marks, 3), and its standard deviation, (frames, marks), m."""
        shape = len(surface), len(self.marks.middle)
        axes = np.stack([self.marks.axes(vertices) for vertices in surface])
        middles = surface[:, self.marks.triangles[self.marks.middle]].mean(axis=2)
        offset, sigma = planes.offset.reshape(shape), planes.sigma.reshape(shape)
        slope = self._slopes(axes, middles, planes)
        normals = axes[:, :, 2] - np.einsum("fmk,fmka->fma", slope, axes[:, :, :2])
        lengths = np.linalg.norm(normals, axis=2)
        places = middles + offset[..., None] * axes[:, :, 2]
        return places, normals / lengths[..., None], sigma / lengths


def _named(names: Iterable[str], places: Array) -> dict[str, Vector]:
    return {name: (float(x), float(y), float(z)) for name, (x, y, z) in zip(names, places, strict=True)}


def _lost(seen: Measurement, counted: Array) -> list[str]:
    """That most points of the body are lost once it moves, of how many count in each frame, (frames,)."""
    rest = np.asarray(seen.data["step"].values) == 0
    if rest.all() or counted[~rest].mean() > _KEPT * counted[rest].mean():
        return []
    share = percent(float(counted[~rest].mean() / max(counted[rest].mean(), 1e-300)))
    return [
        f"of the points of the surface that count at rest only {share} do when the body moves: no set predicts where they are, or "
        "there are too few; do not trust the answer"
    ]


def _usual(counts: Numbers) -> Array:
    """How many points each mark has in a frame in which it has any, (marks,), of counts (frames, marks)."""
    return np.array([float(np.median(own[own > 0])) if own.any() else 0.0 for own in counts.T])


def _level(scene: Scene) -> int:
    """The level on which the surface is predicted."""
    mixed = scene.material.formulation == "mixed"
    for number in reversed(range(1, len(scene.levels))):
        level = scene.levels[number]
        if level_mesh(scene, level).unknowns(level.degree, mixed) <= _UNKNOWNS:
            return number
    return 0


def _marks(scene: Scene, measurement: Measurement) -> SurfaceMarks:
    cloud = measurement.cloud
    assert cloud is not None
    numbers = cloud.numbers(measurement.data)
    at_rest = np.asarray(measurement.data["step"].values) == 0
    rest = cloud.points[(numbers >= 0) & at_rest[numbers]]
    if not len(rest):
        raise InputError(f"{measurement.source}: holds no point of the surface at step 0, where the body is at rest")
    if len(rest) < LEAST_POINTS * at_rest.sum():
        raise InputError(
            f"{measurement.source}: holds {len(rest)} points of the surface at step 0, in {at_rest.sum()} action(s); at least "
            f"{LEAST_POINTS} in each are needed"
        )
    per_frame = float(np.median(np.bincount(numbers[numbers >= 0])))
    marks = SurfaceMarks.spread(scene, rest, per_frame, cloud.camera)
    away = float(np.median(np.linalg.norm(rest - _nearest(marks, rest), axis=1)))
    if not len(marks.middle) and away <= _APART * marks.size:
        raise InputError(
            f"{measurement.source}: at step 0 no part of the surface is recognised in the points; are they of the body, and not of "
            "what covers it?"
        )
    if away > _APART * marks.size:
        unit = measurement.units.length
        raise InputError(
            f"{measurement.source}: at step 0 the points of the surface are {show(away, 'mm')} (median) from that of the body, "
            f"whose size is {show(marks.size, 'mm')}: check length_unit ('{unit}') and the frame of the points"
        )
    return marks


def _nearest(marks: SurfaceMarks, points: Array) -> Array:
    from scipy.spatial import cKDTree

    return np.asarray(marks.vertices[cKDTree(marks.vertices).query(points)[1]])


def _with_marks(seen: Measurement, names: Iterable[str], places: Array, normals: Array, sigma: Array) -> Measurement:
    """The measurement with the marks as further fiducials; where `sigma` is NaN they are not seen."""
    there = np.isfinite(sigma)[..., None]
    dims = "frame", "fiducial", "axis"
    known = [name for name in seen.fiducial_names if name not in set(names)]
    before = seen.data.sel(fiducial=known)
    shape = (len(places), len(known), 3)
    own = before["sigma"].values if "sigma" in before else np.full(shape, np.nan)
    data = seen.data.drop_dims("fiducial").assign_coords(fiducial=[*known, *names], axis=AXES)
    data["position"] = (dims, np.concatenate([before["position"].values, np.where(there, places, np.nan)], axis=1))
    data["normal"] = (dims, np.concatenate([np.full(shape, np.nan), np.where(there, normals, np.nan)], axis=1))
    data["sigma"] = (
        dims,
        np.concatenate([own, np.where(there, np.repeat(sigma[..., None], 3, axis=2), np.nan)], axis=1),
    )
    return replace(seen, data=data).validated()
