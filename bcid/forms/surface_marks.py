"""Surface marks: places on the surface of a body, spread over what a depth camera sees of it, and the piece around each.

Points of a cloud have no identity. Which mark one belongs to, and how far it is from the surface there, depends on where the
surface is predicted to be: points are brought to the nearest facet of it, as in the iterative closest point method, and their
heights above it count, not their places along it (Chen & Medioni, Image and Vision Computing 10 (1992) 145).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.mesh.body_mesh import among, halved_edges
from bcid.measurement.plane_fits import Pieces, fit_planes, spread_about_zero
from bcid.scene import Scene

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]
# Marks at least and at most, and points that a frame has for each of them.
_FEWEST, _MOST, _PER_MARK = 8, 128, 10
# So many facets show the shape of a surface well enough.
_FACETS = 1500
# Marks that prove not to be seen at rest are spread anew so often.
_PASSES = 3
# A facet belongs to a mark up to so many times the distance of marks, where the surface is not turned by more than 60 degrees.
_NEAR, _TURNED = 2.0, 0.5
# So many marks around one, itself among them, tell how the surface is tilted there.
_AROUND = 9
# A point is above a facet when its foot is within so many times the facet's radius.
_ABOVE = 1.5


def surface_mesh(scene: Scene) -> BodyMesh:
    """The coarsest level of a scene that shows the surface well enough without facets being cut, or its finest."""
    for level in scene.levels:
        mesh = level_mesh(scene, level)
        if len(mesh.boundary) >= _FACETS:
            break
    return mesh


@dataclass(frozen=True)
class Facets:
    """Facets of a surface in one state: middles (k, 3), unit normals (k, 3), and radii (k,), m."""

    middles: Array
    normals: Array
    radii: Array

    @classmethod
    def of(cls, corners: Array) -> Facets:
        """Of triangles (k, 3, 3) that run against the clock from outside."""
        middles = corners.mean(axis=1)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
        return cls(middles, normals, np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1))

    def above(self, points: Array, among: Numbers) -> tuple[Numbers, Array]:
        """The facet `among` some that each point (n, 3) is above or below, -1 for none, and its height, m, each (n,)."""
        near = among[cKDTree(self.middles[among]).query(points)[1]]
        away = points - self.middles[near]
        heights = np.einsum("na,na->n", away, self.normals[near])
        beside = np.sqrt(np.maximum(np.einsum("na,na->n", away, away) - heights**2, 0.0))
        return np.where(beside <= _ABOVE * self.radii[near], near, -1), heights


@dataclass(frozen=True)
class SurfaceMarks:
    """Marks on a surface.

    Attributes:
        vertices: of the surface at rest, shape (v, 3), m.
        triangles: shape (k, 3).
        mark: number of the mark that each triangle belongs to, -1 for none, shape (k,).
        middle: the triangle in the middle of each mark's piece, shape (marks,).
        gripped: which triangles the gripper hides, shape (k,).
        sag: how far what is seen at rest is from it, RMS, m.
        size: of the body, m.
    """

    vertices: Array
    triangles: Numbers
    mark: Numbers
    middle: Numbers
    gripped: NDArray[np.bool_]
    sag: float
    size: float

    @classmethod
    def spread(cls, scene: Scene, rest: Array, per_frame: float, camera: Array | None = None) -> SurfaceMarks:
        """Marks over what points (n, 3), m, show of a body at rest, fewer where a frame has few points.

        Where the place of the `camera` is known, m, only on what looks at it.
        """
        mesh = surface_mesh(scene)
        gripped: NDArray[np.bool_] = np.zeros(len(mesh.boundary), dtype=bool)
        for name, grasp in scene.grasps.items():
            gripped = gripped | among(mesh.boundary, mesh.select(grasp.region, f"grasp {name}"))
        numbers, inverse = np.unique(mesh.boundary, return_inverse=True)
        vertices: Array = mesh.points[numbers]
        triangles: Numbers = inverse.reshape(-1, 3)
        while len(triangles) < _FACETS:
            vertices, triangles = halved_edges(vertices, triangles)
            gripped = np.tile(gripped, 4)
        facets = Facets.of(vertices[triangles])
        looking = np.ones(len(triangles), dtype=bool)
        if camera is not None:
            looking = np.einsum("ka,ka->k", facets.normals, camera - facets.middles) > 0
        near, heights = facets.above(rest, np.flatnonzero(looking))
        sag, on_it = spread_about_zero(heights[near >= 0])
        shown = np.unique(near[near >= 0][on_it > 0.5])
        shown = shown[~gripped[shown]]
        count = int(np.clip(per_frame / _PER_MARK, _FEWEST, _MOST))
        for _ in range(_PASSES):
            middle, mark = _pieces(facets, shown, BodyMesh(vertices, triangles).area(triangles[shown]), count)
            made = cls(vertices, triangles, np.where(gripped, -1, mark), middle, gripped, sag, mesh.size)
            seen = made.seen_at_rest(rest)
            shown = shown[seen[mark[shown]]]
        return made.only(seen)

    def seen_at_rest(self, points: Array) -> NDArray[np.bool_]:
        """Which marks are among points (n, 3), m, that were seen of the body at rest, and no chance neighbours of others."""
        facets, count = self.facets(self.vertices), len(self.middle)
        near, heights = facets.above(points, self.looked_at)
        mark = np.where(near >= 0, self.mark[near], -1)
        there = np.flatnonzero(mark >= 0)
        mark, unstated = mark[there], np.full(len(there), np.nan)
        usual = float(np.median(np.bincount(mark, minlength=count))) if count else 0.0
        beside = self.beside(facets, self.axes(self.vertices), mark, points[there])
        pieces = Pieces(mark, heights[there], beside, unstated, np.full(count, self.sag), np.full(count, usual))
        return np.isfinite(fit_planes(pieces).offset)

    def only(self, kept: NDArray[np.bool_]) -> SurfaceMarks:
        """Some of the marks, (marks,)."""
        number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
        return replace(self, mark=number[self.mark], middle=self.middle[kept])

    def axes(self, vertices: Array) -> Array:
        """Two unit vectors along the surface and its normal, at each mark, (marks, 3, 3), with its vertices (v, 3) elsewhere."""
        corners = vertices[self.triangles[self.middle]]
        along = corners[:, 1] - corners[:, 0]
        along = along / np.linalg.norm(along, axis=1)[:, None]
        normal = np.cross(along, corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return np.stack([along, np.cross(normal, along), normal], axis=1)

    @cached_property
    def neighbours(self) -> list[Numbers]:
        """The marks around each, itself among them."""
        normals = self.facets(self.vertices).normals[self.middle]
        alike = normals @ normals.T > _TURNED
        found = cKDTree(self.rest).query(self.rest, min(_AROUND, len(self.rest)))[1].reshape(len(self.rest), -1)
        return [near[alike[number, near]] for number, near in enumerate(found)]

    def beside(self, facets: Facets, axes: Array, mark: Numbers, points: Array) -> Array:
        """Where points (n, 3), m, are beside the marks (n,) that they belong to, along the surface, shape (n, 2), m."""
        return np.einsum("nka,na->nk", axes[mark, :2], points - facets.middles[self.middle[mark]])

    @property
    def rest(self) -> Array:
        """Where the marks are at rest, shape (marks, 3), m."""
        return np.asarray(self.vertices[self.triangles[self.middle]].mean(axis=1))

    @cached_property
    def looked_at(self) -> Numbers:
        """The triangles that points are looked for at: those of marks, and those of the grip, whose points are not of the body."""
        return np.flatnonzero((self.mark >= 0) | self.gripped)

    def facets(self, vertices: Array) -> Facets:
        """The surface with its vertices (v, 3), m, elsewhere."""
        return Facets.of(vertices[self.triangles])


def _pieces(facets: Facets, shown: Numbers, area: float, count: int) -> tuple[Numbers, Numbers]:
    """Facets in the middle of pieces, each as far from the others as can be, and the piece of every facet.

    Facets that look elsewhere are further apart than they are in space, so that a piece does not go around an edge.
    """
    if not len(shown):
        return np.zeros(0, np.int64), np.full(len(facets.middles), -1)
    apart = float(np.sqrt(max(area, 1e-300) / count))
    place = np.hstack([facets.middles, apart * facets.normals])
    chosen = [int(shown[np.lexsort(facets.middles[shown].T)[0]])]
    distance = np.linalg.norm(place[shown] - place[chosen[0]], axis=1)
    while len(chosen) < min(count, len(shown)):
        chosen.append(int(shown[distance.argmax()]))
        distance = np.minimum(distance, np.linalg.norm(place[shown] - place[chosen[-1]], axis=1))
    middle = np.array(chosen)
    away, piece = cKDTree(place[middle]).query(place)
    alike = np.einsum("ka,ka->k", facets.normals, facets.normals[middle[piece]]) > _TURNED
    return middle, np.where((away <= _NEAR * apart) & alike, piece, -1)
