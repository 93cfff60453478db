"""Meshes as plain arrays: made by gmsh or read from a file in a child process, checked, refined.

The arrays are the same on every rank, so that numbers never depend on how a mesh was distributed.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.collective import on_root
from bcid.errors import InputError, Problems, nearest
from bcid.fingerprint import file_fingerprint, fingerprint
from bcid.scene import Level, Region, Scene
from bcid.scratch import require, temporary_folder

Points = NDArray[np.float64]
Cells = NDArray[np.int64]

TIME_LIMIT = 600.0
_EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
# Seen from outside, each face runs against the clock.
_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


@dataclass(frozen=True)
class BodyMesh:
    """Linear tetrahedra with named parts of the boundary.

    Attributes:
        points: nodes, shape (nodes, 3), m.
        cells: node numbers of tetrahedra, shape (cells, 4), positively oriented.
        groups: node numbers of named triangles (k, 3), lines (k, 2) or points (k, 1).
    """

    points: Points
    cells: Cells
    groups: dict[str, Cells] = field(default_factory=dict)

    @cached_property
    def boundary(self) -> Cells:
        """Triangles that belong to one tetrahedron only, with outward normals, shape (k, 3)."""
        faces = self.cells[:, _FACES].reshape(-1, 3)
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        return faces[first[count == 1]]

    @cached_property
    def size(self) -> float:
        """Diagonal of the bounding box, m."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @cached_property
    def volume(self) -> float:
        """Volume, m^3."""
        return float(_volumes(self.points, self.cells).sum())

    def unknowns(self, degree: int, mixed: bool = False) -> int:
        """Number of unknowns that a displacement of this degree has on the mesh (with pressures one degree lower if mixed)."""
        nodes = len(self.points)
        edges = len(np.unique(np.sort(self.cells[:, _EDGES].reshape(-1, 2), axis=1), axis=0)) if degree > 1 else 0
        faces = (4 * len(self.cells) + len(self.boundary)) // 2 if degree == 3 else 0
        pressures = nodes + (edges if degree == 3 else 0)
        return 3 * (nodes + (degree - 1) * edges + faces) + (pressures if mixed else 0)

    def fingerprint(self) -> str:
        """Short hash of nodes, cells and groups."""
        return fingerprint({"points": self.points, "cells": self.cells, "groups": self.groups})

    def select(self, region: Region, what: str) -> Cells:
        """Entities of a region: triangles (k, 3), or lines or points when its groups are such.

        Raises:
            InputError: a group the mesh does not have, or a box, plane or piece without any facet.
        """
        if region.groups:
            parts = [self._group(name, what) for name in region.groups]
            if len({part.shape[1] for part in parts}) > 1:
                raise InputError(f"{what}: groups {', '.join(region.groups)} mix surfaces, lines and points")
            entities = np.vstack(parts)
        else:
            entities = self.boundary
        tolerance = 1e-6 * self.size
        inside = np.ones(len(entities), dtype=bool)
        corners = self.points[entities]
        if region.box:
            low, high = np.array(region.box.lower) - tolerance, np.array(region.box.upper) + tolerance
            inside &= ((corners >= low) & (corners <= high)).all(axis=(1, 2))
        if region.plane:
            distance = (corners - np.array(region.plane.point)) @ np.array(region.plane.normal)
            inside &= (np.abs(distance) <= tolerance).all(axis=1)
        if region.within and inside.any():
            # Both bounds are moved alike, so that neighbours still meet: a middle on the cut belongs to the upper one
            # whatever its round-off.
            low, high = np.array(region.within.lower) - tolerance, np.array(region.within.upper) - tolerance
            middle = corners.mean(axis=1)
            inside &= ((middle >= low) & (middle < high)).all(axis=1)
            if not inside.any():
                raise InputError(
                    f"{what}: no facet has its middle in this piece of the surface; "
                    "make larger pieces, or start at a finer level (--coarsest)"
                )
        if not inside.any():
            low, high = self.points.min(axis=0) * 1e3, self.points.max(axis=0) * 1e3
            raise InputError(
                f"{what}: no facet of the boundary lies wholly in the box or on the plane; the body spans "
                f"{_triple(low)} to {_triple(high)} mm; enlarge the box or use a finer mesh"
            )
        return entities[inside]

    def _group(self, name: str, what: str) -> Cells:
        if name not in self.groups:
            raise InputError(f"{what}: the mesh has no physical group '{name}'; {nearest(name, self.groups)}")
        return self.groups[name]

    def refined(self) -> BodyMesh:
        """Every tetrahedron cut into eight, every named triangle into four, every line into two."""
        edges = np.unique(np.sort(self.cells[:, _EDGES].reshape(-1, 2), axis=1), axis=0)
        code = edges[:, 0] * len(self.points) + edges[:, 1]
        points = np.vstack([self.points, self.points[edges].mean(axis=1)])

        def middle(a: Cells, b: Cells) -> Cells:
            wanted = np.minimum(a, b) * len(self.points) + np.maximum(a, b)
            return len(self.points) + np.searchsorted(code, wanted)

        cells = _cut_tetrahedra(self.cells, middle, points)
        groups = {name: _cut(entities, middle) for name, entities in self.groups.items()}
        return BodyMesh(points, cells, groups)


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
    return _oriented(points, np.vstack(corners + inner))


def _volumes(points: Points, cells: Cells) -> Points:
    a, b, c, d = (points[cells[:, i]] for i in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6


def _oriented(points: Points, cells: Cells) -> Cells:
    cells = cells.copy()
    turned = _volumes(points, cells) < 0
    cells[turned, 2], cells[turned, 3] = cells[turned, 3], cells[turned, 2].copy()
    return cells


def level_mesh(scene: Scene, level: Level, comm: Any = None) -> BodyMesh:
    """Mesh of one level of a scene; collective on `comm` (rank 0 makes it, all get it).

    Raises:
        InputError: gmsh or meshio cannot make sense of the geometry, or the mesh is damaged.
    """
    return on_root(comm, lambda: _level_mesh(scene, level))


def _level_mesh(scene: Scene, level: Level) -> BodyMesh:
    size = level.element_size and level.element_size / scene.length_unit
    points, cells, groups = _load(
        scene.geometry, size, tuple(scene.parameters.items()), file_fingerprint(scene.geometry)
    )
    mesh = checked(BodyMesh(points * scene.length_unit, cells, groups), scene.geometry)
    for _ in range(level.refinements):
        mesh = mesh.refined()
    _check_places(scene, level, mesh)
    return mesh


def level_name(scene: Scene, level: Level) -> str:
    """A level in words: "level 0 (elements of 50 mm)"."""
    number = f"level {scene.levels.index(level)}" if level in scene.levels else "a level"
    size = (
        f"{level.refinements} refinements"
        if level.element_size is None
        else f"elements of {level.element_size * 1e3:.4g} mm"
    )
    return f"{number} ({size})"


def _check_places(scene: Scene, level: Level, mesh: BodyMesh) -> None:
    """Every place of the scene must be on the mesh, and no facet may belong both to a patch and to a grasp."""
    problems = Problems(f"scene {scene.source} and geometry {scene.geometry.name}, {level_name(scene, level)}")
    facets: dict[tuple[str, str], Cells] = {}
    grasps = {name: grasp.region for name, grasp in scene.grasps.items()}
    for kind, regions in (("patch", scene.patches), ("grasp", grasps), ("place", scene.places)):
        for name, region in regions.items():
            try:
                facets[kind, name] = mesh.select(region, f"{kind} {name}")
            except InputError as error:
                problems.add(scene.source, str(error))
    for (kind, name), mine in facets.items():
        for (other, held), theirs in facets.items():
            if kind == "patch" and other == "grasp" and mine.shape[1] == theirs.shape[1]:
                shared = {tuple(row) for row in np.sort(mine, axis=1)} & {tuple(row) for row in np.sort(theirs, axis=1)}
                if shared:
                    problems.add(
                        scene.source, f"patch {name} and grasp {held} share {len(shared)} facets: keep them apart"
                    )
    problems.raise_if_any()


@lru_cache(maxsize=8)
def _load(
    path: Path, element_size: float | None, parameters: tuple[tuple[str, float], ...], _content: str
) -> tuple[Points, Cells, dict[str, Cells]]:
    """Run the loader in a child process: a damaged file may make gmsh abort, and must not take this process along.

    The last results are kept for as long as the content of the file is the same: patches are made and looked for on the
    meshes of several levels before any is solved on.
    """
    refuse_scripts(path)
    with temporary_folder("bcid-mesh-") as folder:
        out = folder / "mesh.npz"
        command = [
            sys.executable,
            "-m",
            "bcid.forms.mesh_child",
            str(path.resolve()),
            str(out),
            repr(element_size or 0.0),
            *(f"{name}={value!r}" for name, value in parameters),
        ]
        try:
            child = subprocess.run(
                command, env=child_environment(), capture_output=True, text=True, timeout=TIME_LIMIT, check=False
            )
        except subprocess.TimeoutExpired:
            raise InputError(f"{path}: meshing took more than {TIME_LIMIT:.0f} s; choose larger elements") from None
        if child.returncode != 0 or not out.exists():
            require()
            said = (child.stdout + child.stderr).strip().splitlines()
            reason = said[-1] if said else f"the loader died with code {child.returncode}"
            raise InputError(f"{path}: cannot be meshed: {reason}")
        with np.load(out, allow_pickle=False) as data:
            groups = {name[6:]: data[name] for name in data.files if name.startswith("group:")}
            return data["points"], data["cells"], groups


def refuse_scripts(path: Path) -> None:
    """Refuse a mesh file that gmsh would take for a script, and run."""
    if path.suffix == ".geo":
        return
    with path.open("rb") as stream:
        head = stream.read(11)
    if path.suffix == ".msh" and head != b"$MeshFormat":
        raise InputError(
            f"{path}: does not start with $MeshFormat; gmsh would run it as a script, so it is refused; "
            "save it as a gmsh mesh (format 4.1)"
        )


def child_environment() -> dict[str, str]:
    """Without the variables that would make the child a member of this MPI job."""
    mpi = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "MPIR_")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(mpi)}
    root = str(Path(__file__).resolve().parents[2])
    kept["PYTHONPATH"] = os.pathsep.join(filter(None, [root, kept.get("PYTHONPATH", "")]))
    return kept


def checked(mesh: BodyMesh, path: Path) -> BodyMesh:
    """The mesh with unused nodes dropped and cells oriented, or an `InputError` that says what is wrong with it."""
    points, cells = mesh.points, mesh.cells
    if len(cells) == 0:
        raise InputError(f"{path}: holds no tetrahedra; bcid needs a solid mesh (in gmsh: a Physical Volume)")
    if not np.isfinite(points).all():
        raise InputError(
            f"{path}: node {int(np.argmin(np.isfinite(points).all(axis=1)))} has a coordinate that is not finite"
        )
    if cells.min() < 0 or cells.max() >= len(points):
        raise InputError(f"{path}: a tetrahedron names node {int(cells.max())}, but there are {len(points)} nodes")
    used, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, 4)
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    groups = {}
    for name, entities in mesh.groups.items():
        groups[name] = number[entities]
        if (groups[name] < 0).any():
            raise InputError(f"{path}: physical group '{name}' has nodes that belong to no tetrahedron")
    mesh = BodyMesh(points[used], _oriented(points[used], cells), groups)
    _check_shapes(mesh, path)
    return mesh


def _check_shapes(mesh: BodyMesh, path: Path) -> None:
    if len(np.unique(np.sort(mesh.cells, axis=1), axis=0)) < len(mesh.cells):
        raise InputError(f"{path}: the same tetrahedron stands twice")
    _, owners = np.unique(np.sort(mesh.cells[:, _FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    if owners.max() > 2:
        raise InputError(f"{path}: a triangle belongs to {owners.max()} tetrahedra: cells overlap")
    volumes = _volumes(mesh.points, mesh.cells)
    edges = np.linalg.norm(mesh.points[mesh.cells[:, _EDGES[:, 0]]] - mesh.points[mesh.cells[:, _EDGES[:, 1]]], axis=2)
    flat = int(np.argmin(volumes / edges.max(axis=1) ** 3))
    if volumes[flat] <= 1e-6 * edges[flat].max() ** 3:
        raise InputError(f"{path}: tetrahedron {flat} is flat (volume {volumes[flat]:.3g} m^3); remesh the body")
    _check_connected(mesh, path)
    rounded = np.round(mesh.points / (1e-9 * mesh.size)).astype(np.int64)
    if len(np.unique(rounded, axis=0)) < len(mesh.points):
        raise InputError(f"{path}: two nodes stand at the same place, so the body has a hidden cut; merge them")


def _check_connected(mesh: BodyMesh, path: Path) -> None:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    pairs = mesh.cells[:, _EDGES].reshape(-1, 2)
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(mesh.points),) * 2)
    parts = connected_components(graph, directed=False)[0]
    if parts > 1:
        raise InputError(f"{path}: the body falls into {parts} unconnected parts; join them or keep one")


def _triple(values: Points) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"
