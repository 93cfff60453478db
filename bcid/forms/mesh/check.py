"""Is a mesh sound, and does it hold what a scene wants of it?"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bcid.base.errors import InputError, Problems
from bcid.forms.mesh.body_mesh import EDGES, FACES, BodyMesh, Cells, oriented, triple, volumes
from bcid.forms.mesh.shares import share
from bcid.scene import Region, Scene
from bcid.scene.geometry_file import PROGRAM, kind_of

# A mesh of more tetrahedra is not made: solving on it takes more than 100 GB.
MOST_CELLS = 5_000_000
_PLURALS = {"patch": "patches", "grasp": "grasps"}


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
    parts = {name: number[tetrahedra] for name, tetrahedra in mesh.parts.items()}
    mesh = replace(mesh, points=points[used], cells=oriented(points[used], cells), groups=groups, parts=parts)
    _check_shapes(mesh, path)
    return mesh


def _check_shapes(mesh: BodyMesh, path: Path) -> None:
    if len(np.unique(np.sort(mesh.cells, axis=1), axis=0)) < len(mesh.cells):
        raise InputError(f"{path}: the same tetrahedron stands twice")
    _, owners = np.unique(np.sort(mesh.cells[:, FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    if owners.max() > 2:
        raise InputError(f"{path}: a triangle belongs to {owners.max()} tetrahedra: cells overlap")
    sizes = volumes(mesh.points, mesh.cells)
    edges = np.linalg.norm(mesh.points[mesh.cells[:, EDGES[:, 0]]] - mesh.points[mesh.cells[:, EDGES[:, 1]]], axis=2)
    flat = int(np.argmin(sizes / edges.max(axis=1) ** 3))
    if sizes[flat] <= 1e-6 * edges[flat].max() ** 3:
        raise InputError(f"{path}: tetrahedron {flat} is flat (volume {sizes[flat]:.3g} m^3); remesh the body")
    _check_connected(mesh, path)
    rounded = np.round(mesh.points / (1e-9 * mesh.size)).astype(np.int64)
    if len(np.unique(rounded, axis=0)) < len(mesh.points):
        raise InputError(f"{path}: two nodes stand at the same place, so the body has a hidden cut; merge them")
    _check_surface(mesh, path)


def _check_connected(mesh: BodyMesh, path: Path) -> None:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    pairs = mesh.cells[:, EDGES].reshape(-1, 2)
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(mesh.points),) * 2)
    parts = connected_components(graph, directed=False)[0]
    if parts > 1:
        raise InputError(f"{path}: the body falls into {parts} unconnected parts; join them or keep one")


def _check_surface(mesh: BodyMesh, path: Path) -> None:
    """The boundary is closed and does not touch itself, and no void is as small as a tetrahedron: one is missing there."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    boundary = mesh.boundary
    edges = np.sort(boundary[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, number, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    if (count != 2).any():
        where = mesh.points[edges[np.flatnonzero(count[number.ravel()] != 2)[0]]].mean(axis=0) * 1e3
        raise InputError(
            f"{path}: the boundary touches itself along an edge at {triple(where)} mm; is a tetrahedron missing?"
        )
    owner = np.repeat(np.arange(len(boundary)), 3)[np.argsort(number.ravel(), kind="stable")].reshape(-1, 2)
    graph = coo_matrix((np.ones(len(owner)), owner.T), shape=(len(boundary),) * 2)
    parts, part = connected_components(graph, directed=False)
    for void in np.flatnonzero(np.bincount(part, minlength=parts) == len(FACES)) if parts > 1 else ():
        where = mesh.points[boundary[part == void]].mean(axis=(0, 1)) * 1e3
        raise InputError(f"{path}: a tetrahedron is missing inside the body, at {triple(where)} mm; remesh it")


def expected_cells(volume: float, size: float) -> float:
    """Number of regular tetrahedra with edges of a size that fill a volume."""
    return 6 * math.sqrt(2) * volume / size**3


def layer_cells(area: float, size: float) -> float:
    """Number of tetrahedra of one layer on equilateral triangles with edges of a size that fill an area: three on each."""
    return 3 * 4 / math.sqrt(3) * area / size**2


def cut_into(scene: Scene) -> float:
    """Into how many tetrahedra a refinement cuts one, on average: the layer of a sheet stays one layer."""
    return 4.0 if scene.thickness else 8.0


def cells_expected(scene: Scene, mesh: BodyMesh, size: float) -> float:
    """Number of tetrahedra that elements of a size (m) are in the body of a mesh, or in the layer of a sheet."""
    return layer_cells(mesh.volume / scene.thickness, size) if scene.thickness else expected_cells(mesh.volume, size)


def refuse_many(cells: float, size: float, spans: Sequence[float]) -> None:
    """Refuse far more elements of a size than can be solved on, in a body of these extents in the unit of its file.

    Raises:
        InputError: with the number of tetrahedra.
    """
    if cells > MOST_CELLS:
        extent = " x ".join(f"{span:.4g}" for span in spans)
        raise InputError(
            f"elements of {size:.4g} in a body of {extent} (in the unit of the file) are about {cells:.1g} tetrahedra, "
            f"more than {MOST_CELLS:,}; choose larger elements, or mend geometry.length_unit"
        )


def check_fineness(scene: Scene, mesh: BodyMesh) -> None:
    """Refuse levels with far more elements than can be solved on, by the volume of the body; `mesh` is without refinement.

    Raises:
        InputError: names the levels.
    """
    problems = Problems(f"scene {scene.source}")
    for number, level in enumerate(scene.levels):
        if level.element_size is None:
            cells, what = len(mesh.cells) * cut_into(scene) ** level.refinements, f"{level.refinements} refinements"
        else:
            cells = cells_expected(scene, mesh, level.element_size)
            what = f"elements of {level.element_size * 1e3:.4g} mm"
        if cells > MOST_CELLS:
            problems.add(
                scene.source,
                f"levels[{number}]: {what} in a body of {mesh.volume * 1e6:.4g} cm^3 are about {cells:.1g} tetrahedra, "
                f"more than {MOST_CELLS:,}; choose larger elements, or mend geometry.length_unit",
            )
    problems.raise_if_any()


def check_places(scene: Scene, name: str, mesh: BodyMesh) -> None:
    """Every place of the scene must be on the boundary of a mesh, and every region of the body inside of it.

    No facet of a patch may be gripped, driven by points, or known to be held.

    Raises:
        InputError: with every problem; `name` is that of the level.
    """
    problems = Problems(f"scene {scene.source} and geometry {scene.geometry.name}, {name}")
    facets: dict[tuple[str, str], Cells] = {}
    for kind, named in places(scene).items():
        for place, region in named.items():
            try:
                found = mesh.select(region, f"{kind} {place}")
            except InputError as error:
                problems.add(scene.source, str(error))
                continue
            facets[kind, place] = found
    for part, shape in scene.regions.items():
        try:
            share(mesh, shape, f"region {part}")
        except InputError as error:
            problems.add(scene.source, str(error))
    for (kind, place), mine in facets.items():
        for (other, held), theirs in facets.items():
            apart = other in ("grasp", "driven") or (other == "held" and len(scene.held[held]) == 3)
            if kind == "patch" and apart and mine.shape[1] == theirs.shape[1]:
                shared = _rows(mine) & _rows(theirs)
                if shared:
                    problems.add(
                        scene.source, f"patch {place} and {other} {held} share {len(shared)} facets: keep them apart"
                    )
    problems.raise_if_any()


def check_groups(scene: Scene, mesh: BodyMesh) -> None:
    """The physical groups that places are made of lie on the boundary, and no triangle is missing in them.

    `mesh` is without refinement: what is missing in a file has the size of one triangle there.

    Raises:
        InputError: with every problem.
    """
    problems = Problems(f"scene {scene.source} and geometry {scene.geometry.name}")
    names = {name for region in regions(scene) for name in region.groups}
    groups = {
        name: mesh.groups[name] for name in sorted(names) if name in mesh.groups and mesh.groups[name].shape[1] == 3
    }
    named = {row for triangles in groups.values() for row in _rows(triangles)}
    for name, triangles in groups.items():
        for text in group_faults(mesh, triangles, named):
            problems.add(scene.geometry, f"physical group '{name}': {text}; remesh it")
    # The groups of a .geo are whole; a file may have lost a triangle between two of them.
    if groups and not problems.found and kind_of(scene.geometry) != PROGRAM:
        where = _gap(mesh, np.vstack(list(groups.values())), named)
        if where:
            problems.add(
                scene.geometry,
                f"a triangle at {_middle(mesh, where)} is in no group of the scene, but all its neighbours are: put it into "
                "one of them, or make smaller elements there",
            )
    problems.raise_if_any()


def group_faults(mesh: BodyMesh, triangles: Cells, named: Iterable[tuple[int, ...]] = ()) -> list[str]:
    """What is wrong with the triangles (k, 3) of a group: not on the boundary, or one of them missing amid the others.

    A facet that is not among the `named` ones (those of all groups) whose neighbours are all in this group is a hole in it.
    """
    if triangles.shape[1] != 3:
        return []
    mine = _rows(triangles)
    faults = []
    if inner := len(mine - _rows(mesh.boundary)):
        faults.append(f"{inner} of its {len(mine)} triangles are not on the boundary of the body")
    where = _gap(mesh, triangles, {*mine, *named})
    if where:
        faults.append(f"a triangle is missing in it at {_middle(mesh, where)}")
    return faults


def _middle(mesh: BodyMesh, nodes: tuple[int, ...]) -> str:
    return f"{triple(mesh.points[list(nodes)].mean(axis=0) * 1e3)} mm"


def _gap(mesh: BodyMesh, triangles: Cells, named: Container[tuple[int, ...]]) -> tuple[int, ...]:
    """The first facet of the boundary that is not `named` and has one of `triangles` on every side; or ()."""
    edges = {edge for row in _rows(triangles) for edge in _edges(row)}
    among = mesh.boundary[np.isin(mesh.boundary, triangles).all(axis=1)]
    return min((row for row in _rows(among) if row not in named and edges.issuperset(_edges(row))), default=())


def _edges(row: tuple[int, ...]) -> set[tuple[int, ...]]:
    a, b, c = row
    return {(a, b), (b, c), (a, c)}


def places(scene: Scene) -> dict[str, dict[str, Region]]:
    """Named parts of the boundary, by kind."""
    grasps = {name: grasp.region for name, grasp in scene.grasps.items()}
    others: dict[str, dict[str, Region]] = {"held": {}, "driven": {}, "place": {}}
    for name, region in scene.places.items():
        others["held" if name in scene.held else "driven" if name in scene.driven else "place"][name] = region
    return {"patch": scene.patches, "grasp": grasps} | {kind: named for kind, named in others.items() if named}


def regions(scene: Scene) -> list[Region]:
    """All of them, whatever their kind."""
    return [region for kind in places(scene).values() for region in kind.values()]


def _rows(entities: Cells) -> set[tuple[int, ...]]:
    """Entities by their nodes, whatever the order."""
    return {tuple(map(int, row)) for row in np.sort(entities, axis=1)}


def measures(scene: Scene, mesh: BodyMesh) -> list[str]:
    """Volume of the body and areas of its patches and grasps, in sentences: what a damaged or wrong mesh shows in."""
    lines = [f"Body: volume {shown(mesh.volume, 3)}, boundary {shown(mesh.area(mesh.boundary), 2)}."]
    for kind, named in places(scene).items():
        areas = {name: mesh.area(mesh.select(region, name)) for name, region in named.items() if kind != "place"}
        found = [f"{name} {shown(area, 2)}" for name, area in areas.items() if area > 0]
        if found:
            lines.append(f"  {_PLURALS.get(kind, kind)}: {', '.join(found)}")
    return lines + [f"  {note}" for note in (*sheet_in_words(scene, mesh), *mesh.notes)]


def sheet_in_words(scene: Scene, mesh: BodyMesh) -> list[str]:
    """What is special about a sheet; nothing of other bodies."""
    if scene.thickness is None:
        return []
    area, thickness = shown(mesh.volume / scene.thickness, 2), shown(scene.thickness, 1).removesuffix("^1")
    state = "in plane stress, which wrinkles where it would be pushed together" if scene.wrinkles else "in plane stress"
    if scene.thickness_known:
        return [f"A sheet of {area} and a thickness of {thickness}, {state}"]
    return [
        f"A sheet of {area}, {state}. Its thickness is unknown, and it is computed with {thickness}: of numbers in Pa, "
        f"Pa/m and N/m^3 only their products with the thickness are known, which are those of {thickness}"
    ]


def shown(value: float, power: int) -> str:
    """An area or a volume in a unit in which it has few digits before the point."""
    for unit, metre in (("m", 1.0), ("cm", 1e-2), ("mm", 1e-3)):
        if value >= metre**power or unit == "mm":
            return f"{value / metre**power:.4g} {unit}^{power}"
    raise AssertionError
