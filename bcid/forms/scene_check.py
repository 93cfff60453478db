"""What a scene is like before anything is solved: its ladder, the areas of its places, where its fiducials are, what looks odd."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bcid.forms.driving import driving_fiducials
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.mesh.body_mesh import volumes
from bcid.forms.mesh.check import cells_expected, cut_into, places
from bcid.forms.mesh.closest import closest_triangles
from bcid.forms.mesh.length_unit import check_length_unit, fiducial_limit
from bcid.forms.mesh.patches import divided, first_level
from bcid.forms.mesh.shares import share
from bcid.forms.model import Model
from bcid.forms.observe import attach
from bcid.scene import Level, Scene

Array = NDArray[np.float64]

# Levels of more cells are not meshed for this. In meshes of gmsh there are so many parts of the cells that regular tetrahedra
# would be, and so many nodes and edges for each cell.
_MESHED = 200_000
_FILLED, _NODES, _EDGES = 0.6, 0.25, 1.35
# Fewer facets show a place badly; areas that differ by more from level to level are not the same place.
_FEW, _SAME_AREA = 4, 0.2
# A fiducial is on the surface when it is no further from it than this part of the body's size.
_ON = 0.005
# A patch covers less of the boundary than this part: nothing would be seen of it.
_SMALL = 1e-4


@dataclass(frozen=True)
class LevelSize:
    """A level: its nodes, cells and unknowns, and whether it was meshed or its numbers are what is usual."""

    level: Level
    nodes: int
    cells: int
    unknowns: int
    meshed: bool


@dataclass(frozen=True)
class PlaceSize:
    """A patch, grasp or place: how many facets show it on the level that is looked at, their area (m^2) and their middle (m)."""

    kind: str
    name: str
    facets: int
    area: float
    middle: Array


@dataclass(frozen=True)
class RegionSize:
    """A region of the body: its part of the volume, how many cells its border cuts, and its middle (m)."""

    name: str
    part: float
    cut: int
    middle: Array


@dataclass(frozen=True)
class Marker:
    """A fiducial: where it is (m), how far from the surface (m, negative inside), and the patch that it is on, or ""."""

    name: str
    position: Array
    distance: float
    patch: str


@dataclass(frozen=True)
class SceneCheck:
    """What was found of a scene; lengths in m.

    Attributes:
        scene: with divided patches in pieces.
        level: number of the level that is looked at: the coarsest that shows all patches.
        mesh: its mesh.
        rungs: of all levels.
        places: patches, grasps and places, in the order of the scene.
        body_regions: regions of the body.
        markers: the fiducials.
        drivers: how many fiducials drive each driven place.
        warnings: what looks odd and is allowed, in sentences.
    """

    scene: Scene
    level: int
    mesh: BodyMesh
    rungs: tuple[LevelSize, ...]
    places: tuple[PlaceSize, ...]
    body_regions: tuple[RegionSize, ...]
    markers: tuple[Marker, ...]
    drivers: dict[str, int]
    warnings: tuple[str, ...]


def check_scene(scene: Scene) -> SceneCheck:
    """Mesh a scene and look at it; nothing is solved. Not collective.

    Raises:
        InputError: with every problem that would stop the commands that solve.
    """
    scene = divided(scene)
    level, passed = first_level(scene, 0, len(scene.levels) - 1)
    mesh = level_mesh(scene, scene.levels[level])
    limit = fiducial_limit(scene, mesh)
    check_length_unit(scene, mesh, limit)
    markers = tuple(_markers(scene, mesh, limit))
    meshes = dict(_meshes(scene, mesh, level))
    rungs = tuple(_rung(scene, number, mesh, meshes) for number in range(len(scene.levels)))
    found = tuple(_places(scene, mesh))
    warnings = [*passed, *mesh.notes, *_of_places(scene, mesh, found), *_of_levels(scene, found, rungs, meshes, level)]
    warnings += _of_markers(scene, mesh, markers)
    drivers = {name: len(driving_fiducials(scene, mesh, name, scene.fiducial_names)) for name in scene.driven}
    return SceneCheck(scene, level, mesh, rungs, found, tuple(_regions(scene, mesh)), markers, drivers, tuple(warnings))


def _meshes(scene: Scene, mesh: BodyMesh, level: int) -> Iterator[tuple[int, BodyMesh]]:
    """Meshes of the levels that are soon made, by number."""
    for number, rung in enumerate(scene.levels):
        if number == level:
            yield number, mesh
        elif number > level and _cells(scene, mesh, scene.levels[level], rung) <= _MESHED:
            yield number, level_mesh(scene, rung)


def _cells(scene: Scene, mesh: BodyMesh, of: Level, level: Level) -> float:
    """About how many cells a level has, from the mesh of another."""
    if level.element_size is None:
        return float(len(mesh.cells) * cut_into(scene) ** (level.refinements - of.refinements))
    return (1.0 if scene.thickness else _FILLED) * cells_expected(scene, mesh, level.element_size)


def _rung(scene: Scene, number: int, mesh: BodyMesh, meshes: dict[int, BodyMesh]) -> LevelSize:
    level, mixed = scene.levels[number], Model.of(scene).mixed
    if number in meshes:
        made = meshes[number]
        return LevelSize(level, len(made.points), len(made.cells), made.unknowns(level.degree, mixed), True)
    first = next(iter(meshes))
    cells = _cells(scene, mesh, scene.levels[first], level)
    nodes = _NODES * cells
    unknowns = 3 * (nodes + (level.degree - 1) * _EDGES * cells) + (nodes if mixed else 0)
    return LevelSize(level, round(nodes), round(cells), round(unknowns), False)


def _places(scene: Scene, mesh: BodyMesh) -> Iterator[PlaceSize]:
    for kind, regions in places(scene).items():
        for name, region in regions.items():
            facets = mesh.select(region, f"{kind} {name}")
            middle = mesh.points[np.unique(facets)].mean(axis=0)
            yield PlaceSize(kind, name, len(facets), mesh.area(facets), middle)


def _regions(scene: Scene, mesh: BodyMesh) -> Iterator[RegionSize]:
    sizes, middles = volumes(mesh.points, mesh.cells), mesh.points[mesh.cells].mean(axis=1)
    for name, region in scene.regions.items():
        inside = share(mesh, region, f"region {name}")
        weights = inside * sizes
        cut = int(((inside > 0) & (inside < 1)).sum())
        yield RegionSize(name, float(weights.sum()) / mesh.volume, cut, np.average(middles, axis=0, weights=weights))


def _markers(scene: Scene, mesh: BodyMesh, limit: float) -> Iterator[Marker]:
    fixed = attach(mesh, scene.fiducials, limit, scene.source)
    corners = mesh.points[mesh.boundary]
    number, weights = closest_triangles(corners, scene.rest)
    away = np.linalg.norm((weights[:, :, None] * corners[number]).sum(axis=1) - scene.rest, axis=1)
    owner = _owners(scene, mesh)
    for i, (name, found) in enumerate(fixed.items()):
        near = away[i] <= _ON * mesh.size
        distance = away[i] if found.distance > 0 else -away[i]
        yield Marker(
            name, scene.rest[i], float(distance), owner.get(tuple(sorted(mesh.boundary[number[i]])), "") if near else ""
        )


def _owners(scene: Scene, mesh: BodyMesh) -> dict[tuple[int, ...], str]:
    """The patch of each facet that has one, by its nodes."""
    return {
        tuple(map(int, row)): name
        for name, region in scene.patches.items()
        for row in np.sort(mesh.select(region, f"patch {name}"), axis=1)
        if len(row) == 3
    }


def _of_places(scene: Scene, mesh: BodyMesh, found: tuple[PlaceSize, ...]) -> Iterator[str]:
    whole = mesh.area(mesh.boundary)
    few = [place for place in found if place.area > 0 and place.facets < _FEW]
    if few:
        yield f"{_named(few)}: fewer than {_FEW} facets; choose smaller elements if the answer depends on this level"
    tiny = [place for place in found if place.kind == "patch" and 0 < place.area < _SMALL * whole]
    if tiny:
        yield f"{_named(tiny)}: less than {_SMALL:g} of the boundary; it will hardly be told from none"
    yield from _overlaps(scene, mesh)
    if not scene.grasps:
        yield "there is no grasp: only measurements without a gripper can be explained"


def _named(found: Iterable[PlaceSize]) -> str:
    """Places by kind: "patch 1, patch 2, grasp I"."""
    return ", ".join(f"{place.kind} {place.name}" for place in found)


def _overlaps(scene: Scene, mesh: BodyMesh) -> Iterator[str]:
    rows = {
        name: {tuple(map(int, row)) for row in np.sort(mesh.select(region, f"patch {name}"), axis=1)}
        for name, region in scene.patches.items()
    }
    names = list(rows)
    for i, first in enumerate(names):
        for other in names[i + 1 :]:
            shared = rows[first] & rows[other] if _alike(scene, first, other) else set()
            if shared:
                yield f"patches {first} and {other} share {len(shared)} facets: both would be told to be anchored there"


def _alike(scene: Scene, first: str, other: str) -> bool:
    """Whether two patches would hold the same, on one surface: along an axis of both, or a direction of the surface of one."""
    directions = {scene.held_direction(first), scene.held_direction(other)}
    if directions == {""}:
        return bool(set(scene.held_along(first)) & set(scene.held_along(other)))
    return directions != {"normal", "tangent"}


def _of_levels(
    scene: Scene, found: tuple[PlaceSize, ...], rungs: tuple[LevelSize, ...], meshes: dict[int, BodyMesh], level: int
) -> Iterator[str]:
    """Places that are not the same on every level, and levels that are no finer than the one before."""
    regions = {(kind, name): region for kind, named in places(scene).items() for name, region in named.items()}
    ratios = {}
    for place in found:
        if place.area > 0:
            region = regions[place.kind, place.name]
            areas = [mesh.area(mesh.select(region, place.name)) / place.area for mesh in meshes.values()]
            ratios[place.kind, place.name] = max(areas, key=lambda ratio: abs(np.log(ratio)))
    others = [place for place in found if abs(np.log(ratios.get((place.kind, place.name), 1.0))) > _SAME_AREA]
    if others:
        most = max((ratios[place.kind, place.name] for place in others), key=lambda ratio: abs(np.log(ratio)))
        yield (
            f"{_named(others)}: the area on finer levels is not that on level {level} (up to {most:.2g} times as large); choose "
            f"smaller elements on level {level}, or choose these places in another way"
        )
    for number, (coarse, fine) in enumerate(pairwise(rungs), start=1):
        if fine.unknowns <= coarse.unknowns:
            yield f"level {number} has no more unknowns than level {number - 1}: levels go from coarse to fine"


def _of_markers(scene: Scene, mesh: BodyMesh, markers: tuple[Marker, ...]) -> Iterator[str]:
    far = [m.name for m in markers if m.distance > _ON * mesh.size]
    if far:
        yield f"fiducials {', '.join(far)} are off the body: they are taken for the closest point of it"
    for marker in markers:
        if marker.patch:
            yield f"fiducial {marker.name} is on patch {marker.patch}: it tells nothing where that is anchored"
    rounded = np.round(scene.rest / (1e-6 * mesh.size)).astype(np.int64)
    if len(np.unique(rounded, axis=0)) < len(markers):
        yield "two fiducials are at the same place"
