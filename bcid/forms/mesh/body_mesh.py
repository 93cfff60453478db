"""A mesh as plain arrays: tetrahedra and named parts of their boundary.

The arrays are the same on every rank, so that numbers never depend on how a mesh was distributed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, nearest
from bcid.base.fingerprint import fingerprint
from bcid.forms.mesh.fields import Paint
from bcid.forms.mesh.label_voxels import LabelVoxels
from bcid.scene import Box, Facing, Plane, Region, Sphere

Points = NDArray[np.float64]
Cells = NDArray[np.int64]

EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
# Seen from outside, each face runs against the clock.
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]

ENLARGE = "enlarge what chooses it, or use a finer mesh"


@dataclass(frozen=True)
class BodyMesh:
    """Linear tetrahedra with named parts of the boundary.

    Attributes:
        points: nodes, shape (nodes, 3), m.
        cells: node numbers of tetrahedra, shape (cells, 4), positively oriented.
        groups: node numbers of named triangles (k, 3), lines (k, 2) or points (k, 1).
        parts: node numbers of named tetrahedra (k, 4).
        paint: painted fields at the middles of `boundary`; None where the geometry has none.
        voxels: labels of an image inside of the body; None where it has one label, or there is no image.
        notes: what was done to the file's surface or cells to make the mesh, in sentences.
    """

    points: Points
    cells: Cells
    groups: dict[str, Cells] = field(default_factory=dict)
    parts: dict[str, Cells] = field(default_factory=dict)
    paint: Paint | None = None
    notes: tuple[str, ...] = ()
    voxels: LabelVoxels | None = None

    @cached_property
    def boundary(self) -> Cells:
        """Triangles that belong to one tetrahedron only, with outward normals, shape (k, 3)."""
        return self.cells[:, FACES].reshape(-1, 3)[self._outer]

    @cached_property
    def behind(self) -> Cells:
        """The tetrahedron of each triangle of the boundary, shape (k,)."""
        return self._outer // len(FACES)

    @cached_property
    def _outer(self) -> Cells:
        """Which faces of all tetrahedra belong to one of them only."""
        faces = np.sort(self.cells[:, FACES].reshape(-1, 3), axis=1)
        _, first, count = np.unique(faces, axis=0, return_index=True, return_counts=True)
        return first[count == 1]

    @cached_property
    def size(self) -> float:
        """Diagonal of the bounding box, m."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    def area(self, triangles: Cells) -> float:
        """Area of triangles, shape (k, 3), m^2; of lines and points it is zero."""
        if triangles.shape[1] != 3:
            return 0.0
        a, b, c = (self.points[triangles[:, i]] for i in range(3))
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    @cached_property
    def volume(self) -> float:
        """Volume, m^3."""
        return float(volumes(self.points, self.cells).sum())

    def unknowns(self, degree: int, mixed: bool = False) -> int:
        """Number of unknowns that a displacement of this degree has on the mesh (with pressures one degree lower if mixed)."""
        nodes = len(self.points)
        edges = len(np.unique(np.sort(self.cells[:, EDGES].reshape(-1, 2), axis=1), axis=0)) if degree > 1 else 0
        faces = (4 * len(self.cells) + len(self.boundary)) // 2 if degree == 3 else 0
        pressures = nodes + (edges if degree == 3 else 0)
        return 3 * (nodes + (degree - 1) * edges + faces) + (pressures if mixed else 0)

    def fingerprint(self) -> str:
        """Short hash of nodes, cells and groups."""
        return fingerprint({"points": self.points, "cells": self.cells, "groups": self.groups})

    def select(self, region: Region, what: str) -> Cells:
        """Entities of a region: triangles (k, 3), or lines or points when its groups are such.

        Raises:
            InputError: a group or painted field that the mesh does not have, or criteria that no facet meets.
        """
        entities = self._candidates(region, what)
        chosen = self._chosen(entities, region, what)
        if not chosen.any():
            raise InputError(f"{what}: {self._why_none(region)}")
        return entities[chosen]

    def shows(self, region: Region) -> bool:
        """Whether an entity of the mesh is of a region."""
        try:
            self.select(region, "")
        except InputError:
            return False
        return True

    def _chosen(self, entities: Cells, region: Region, what: str) -> NDArray[np.bool_]:
        """Which entities every criterion of a region takes, shape (k,)."""
        tolerance = 1e-6 * self.size
        corners = self.points[entities]
        middle = corners.mean(axis=1)
        chosen = np.ones(len(entities), dtype=bool)
        if region.box:
            chosen &= wholly_in(corners, region.box, tolerance)
        if region.plane:
            chosen &= on_plane(corners, region.plane, tolerance)
        if region.within:
            chosen &= in_piece(middle, region.within, tolerance)
        if region.sphere:
            chosen &= in_sphere(middle, region.sphere, tolerance)
        if region.facing or region.painted:
            facets = self._facets(entities, what)
            chosen &= (facets >= 0) & self._told_by_surface(region, what)[facets]
        return chosen

    def _told_by_surface(self, region: Region, what: str) -> NDArray[np.bool_]:
        """Which facets of the boundary look in the direction of a region, and are painted as it says."""
        chosen = np.ones(len(self.boundary), dtype=bool)
        if region.facing:
            chosen &= looking(self.points[self.boundary], region.facing)
        if region.painted:
            chosen &= (self.paint or Paint(np.zeros((0, 3)), {})).chosen(region.painted, what)
        return chosen

    def _facets(self, entities: Cells, what: str) -> Cells:
        """Rows of the boundary that triangles are, -1 for those that are none, shape (k,)."""
        if entities.shape[1] != 3:
            raise InputError(f"{what}: is made of lines or points; only surfaces have a normal, or are painted")
        rows = np.sort(np.vstack([self.boundary, entities]), axis=1)
        number = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
        facet = np.full(number.max() + 1, -1)
        count = len(self.boundary)
        facet[number[:count]] = np.arange(count)
        return facet[number[count:]]

    def _why_none(self, region: Region) -> str:
        """What to say, and do, when a region has no facet."""
        others = replace(region, within=None)
        if region.within and self._chosen(self._candidates(others, ""), others, "").any():
            return "no facet has its middle in this piece of it; make larger pieces, or take a finer level (--level)"
        low, high = self.points.min(axis=0) * 1e3, self.points.max(axis=0) * 1e3
        return (
            f"no facet of the boundary {missed(region)}; the body spans {triple(low)} to {triple(high)} mm; {ENLARGE}"
        )

    def _candidates(self, region: Region, what: str) -> Cells:
        """Entities of the groups of a region, or the whole boundary."""
        if not region.groups:
            return self.boundary
        parts = [self._group(name, what) for name in region.groups]
        if len({part.shape[1] for part in parts}) > 1:
            raise InputError(f"{what}: groups {', '.join(region.groups)} mix surfaces, lines and points")
        return np.vstack(parts)

    def _group(self, name: str, what: str) -> Cells:
        if name not in self.groups:
            raise InputError(f"{what}: the mesh has no physical group '{name}'; {nearest(name, self.groups)}")
        return self.groups[name]

    def refined(self) -> BodyMesh:
        """Every tetrahedron cut into eight, every named triangle into four, every line into two; without paint."""
        edges = np.unique(np.sort(self.cells[:, EDGES].reshape(-1, 2), axis=1), axis=0)
        code = edges[:, 0] * len(self.points) + edges[:, 1]
        points = np.vstack([self.points, self.points[edges].mean(axis=1)])

        def middle(a: Cells, b: Cells) -> Cells:
            wanted = np.minimum(a, b) * len(self.points) + np.maximum(a, b)
            return len(self.points) + np.searchsorted(code, wanted)

        cells = _cut_tetrahedra(self.cells, middle, points)
        groups = {name: _cut(entities, middle) for name, entities in self.groups.items()}
        parts = {name: _cut_tetrahedra(part, middle, points) for name, part in self.parts.items()}
        return BodyMesh(points, cells, groups, parts, notes=self.notes)


def halved_edges(points: Points, triangles: Cells) -> tuple[Points, Cells]:
    """Points and triangles of a surface whose every triangle is cut into four, which stand as the triangles did, four times."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    both, number = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = (len(points) + number.reshape(-1, 3)).T
    a, b, c = triangles.T
    cut = np.vstack([np.c_[a, ab, ca], np.c_[ab, b, bc], np.c_[ca, bc, c], np.c_[ab, bc, ca]])
    return np.vstack([points, points[both].mean(axis=1)]), cut


def cut_entities(points: Points, triangles: Cells, groups: Mapping[str, Cells]) -> dict[str, Cells]:
    """Named triangles, lines and points of a surface whose triangles `halved_edges` cuts, cut as these are."""
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    code = edges[:, 0] * len(points) + edges[:, 1]

    def middle(a: Cells, b: Cells) -> Cells:
        return len(points) + np.searchsorted(code, np.minimum(a, b) * len(points) + np.maximum(a, b))

    return {name: _cut(entities, middle) for name, entities in groups.items()}


def among(rows: Cells, wanted: Cells) -> NDArray[np.bool_]:
    """Which triangles (k, 3) have the same nodes as one of those wanted, shape (k,)."""
    keys = set(map(tuple, np.sort(wanted, axis=1)))
    return np.array([tuple(row) in keys for row in np.sort(rows, axis=1)], dtype=np.bool_)


def _cut(entities: Cells, middle: Any) -> Cells:
    if entities.shape[1] == 1:
        return entities
    if entities.shape[1] == 2:
        a, b = entities.T
        m = middle(a, b)
        return np.vstack([np.c_[a, m], np.c_[m, b]])
    a, b, c = entities.T
    ab, bc, ca = middle(a, b), middle(b, c), middle(a, c)
    return np.vstack([np.c_[a, ab, ca], np.c_[ab, b, bc], np.c_[ca, bc, c], np.c_[ab, bc, ca]])


def _cut_tetrahedra(cells: Cells, middle: Any, points: Points) -> Cells:
    """Red refinement; the inner octahedron is cut along its shortest diagonal, which keeps the shapes good."""
    a, b, c, d = cells.T
    ab, bc, ca = middle(a, b), middle(b, c), middle(a, c)
    ad, bd, cd = middle(a, d), middle(b, d), middle(c, d)
    corners = [np.c_[a, ab, ca, ad], np.c_[ab, b, bc, bd], np.c_[ca, bc, c, cd], np.c_[ad, bd, cd, d]]
    # Each diagonal with the ring of the four other middles around it.
    rings = [(ab, cd, (bc, ca, ad, bd)), (bc, ad, (ab, ca, cd, bd)), (ca, bd, (ab, bc, cd, ad))]
    lengths = np.array([np.linalg.norm(points[p] - points[q], axis=1) for p, q, _ in rings])
    best = lengths.argmin(axis=0)
    inner = []
    for k, (p, q, ring) in enumerate(rings):
        for i in range(4):
            tet = np.c_[p, q, ring[i], ring[(i + 1) % 4]]
            inner.append(tet[best == k])
    return oriented(points, np.vstack(corners + inner))


def volumes(points: Points, cells: Cells) -> Points:
    """Volumes of tetrahedra, shape (cells,); negative for those turned inside out."""
    a, b, c, d = (points[cells[:, i]] for i in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6


def oriented(points: Points, cells: Cells) -> Cells:
    """The cells with those of negative volume turned the right way round."""
    cells = cells.copy()
    turned = volumes(points, cells) < 0
    cells[turned, 2], cells[turned, 3] = cells[turned, 3], cells[turned, 2].copy()
    return cells


def triple(values: Points) -> str:
    """Three numbers for a message: "(1, 2.5, 3)"."""
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"


def wholly_in(corners: Array, box: Box, tolerance: float) -> Chosen:
    """Which entities (k, corners, 3) have all corners in a box."""
    low, high = np.array(box.lower) - tolerance, np.array(box.upper) + tolerance
    return np.asarray(((corners >= low) & (corners <= high)).all(axis=(1, 2)))


def on_plane(corners: Array, plane: Plane, tolerance: float) -> Chosen:
    """Which entities (k, corners, 3) have all corners on a plane."""
    distance = (corners - np.array(plane.point)) @ np.array(plane.normal)
    return np.asarray((np.abs(distance) <= tolerance).all(axis=1))


def in_piece(middle: Array, box: Box, tolerance: float) -> Chosen:
    """Which middles (k, 3) belong to one of the boxes that tile the space."""
    # Both bounds are moved alike, so that neighbours still meet: a middle on the cut belongs to the upper one
    # whatever its round-off.
    low, high = np.array(box.lower) - tolerance, np.array(box.upper) - tolerance
    return np.asarray(((middle >= low) & (middle < high)).all(axis=1))


def in_sphere(middle: Array, sphere: Sphere, tolerance: float) -> Chosen:
    """Which middles (k, 3) lie in a sphere."""
    return np.asarray(np.linalg.norm(middle - np.array(sphere.centre), axis=1) <= sphere.radius + tolerance)


def looking(corners: Array, facing: Facing) -> Chosen:
    """Which triangles (k, 3, 3), against the clock as seen from outside, look in a direction, to within its angle."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cosine = normal @ np.array(facing.normal) / np.linalg.norm(normal, axis=1)
    return np.asarray(cosine >= np.cos(np.radians(facing.within)) - 1e-9)


def missed(region: Region) -> str:
    """What no facet does, as the end of a sentence."""
    words = [
        (region.box or region.plane, "lies wholly in the box or on the plane"),
        (region.sphere, "has its middle in the sphere"),
        (region.facing, "looks in the direction of the normal, to within the angle"),
        (region.painted, "is painted with the value"),
    ]
    return " and ".join(text for criterion, text in words if criterion) or "is in the group"
