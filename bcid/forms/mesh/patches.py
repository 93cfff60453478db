"""Patches made of surfaces: pieces of a given size, halves of a patch, and the mesh levels that show all of them.

A piece is what one box of a tiling of the space takes of a surface (`Region.within`). The tiling comes from cutting the surface,
as the coarsest level shows it, at the middle of its longest extent, and each part again: it is the same for every level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError, Problems, nearest
from bcid.forms.mesh import BodyMesh, level_mesh, level_name
from bcid.scene import Box, Region, Scene

Array = NDArray[np.float64]

MOST_PIECES = 512
# A piece may exceed the size asked for by this: halving meets no size exactly.
_ABOUT = 1.25
# Extents that differ by less, relatively, are the same: the first axis is cut then, whatever the round-off of the mesh.
_SAME = 1e-6
_EVERYWHERE = Box((-np.inf,) * 3, (np.inf,) * 3)


def divided(scene: Scene, comm: Comm | None = None) -> Scene:
    """The scene with its divided patches replaced by their pieces, "edge.1", "edge.2", ...; collective on `comm`.

    A part is halved while its longest extent exceeds the size by more than a quarter. The pieces are numbered as the
    halves come: all of a lower half before those of the upper one.

    Raises:
        InputError: what is divided is no surface of the body, or has more than `MOST_PIECES` pieces.
    """
    return on_root(comm, lambda: _divided(scene)) if scene.divide else scene


def halves(scene: Scene, names: str | Sequence[str], comm: Comm | None = None) -> Scene:
    """The scene with a patch (or several) replaced by its halves, "3.1" and "3.2" for "3"; collective on `comm`.

    The cut is at the middle of the patch's longest extent; the lower half comes first.

    Raises:
        InputError: there is no such patch, it is no surface, or a half's name is taken.
    """
    return on_root(comm, lambda: _halves(scene, [names] if isinstance(names, str) else names))


def extents(scene: Scene, comm: Comm | None = None) -> dict[str, float]:
    """Longest extent along an axis of every patch, m, as the coarsest level shows it; collective on `comm`."""

    def measure() -> dict[str, float]:
        surface = _Surface(scene)
        return {name: float(np.ptp(surface(r, name).reshape(-1, 3), axis=0).max()) for name, r in scene.patches.items()}

    return on_root(comm, measure)


def touching(scene: Scene, level: int, comm: Comm | None = None) -> dict[str, set[str]]:
    """The patches that share an edge of the mesh with each patch, on a level; collective on `comm`."""

    def find() -> dict[str, set[str]]:
        mesh = level_mesh(scene, scene.levels[level])
        edges = {name: _edges(mesh.select(region, f"patch {name}")) for name, region in scene.patches.items()}
        return {a: {b for b in edges if b != a and edges[a] & edges[b]} for a in edges}

    return on_root(comm, find)


def element_size(scene: Scene, level: int, comm: Comm | None = None) -> float:
    """Size of the elements of a level, m: the scene's, or the mean length of the edges of a mesh file; collective on `comm`."""
    asked = scene.levels[level].element_size
    if asked is not None:
        return asked

    def measure() -> float:
        first = replace(scene.levels[level], refinements=0)
        mesh = level_mesh(_bare(scene), first)
        ends = np.array(sorted(_edges(mesh.boundary)))
        length = np.linalg.norm(mesh.points[ends[:, 0]] - mesh.points[ends[:, 1]], axis=1).mean()
        return float(length / 2 ** scene.levels[level].refinements)

    return on_root(comm, measure)


def first_level(scene: Scene, first: int, last: int, comm: Comm | None = None) -> tuple[int, list[str]]:
    """The first level from `first` to `last` on which every piece has a facet; collective on `comm`.

    Returns:
        The level, and for every level passed over a sentence that says why. Only scenes with pieces are meshed.

    Raises:
        InputError: there is none.
    """
    if not any(region.within for region in scene.patches.values()):
        return first, []
    return on_root(comm, lambda: _first_level(scene, first, last))


def _first_level(scene: Scene, first: int, last: int) -> tuple[int, list[str]]:
    passed: list[str] = []
    for number in range(first, last + 1):
        missing = _missing(scene, level_mesh(_bare(scene), scene.levels[number]))
        if not missing:
            return number, passed
        shown = ", ".join(missing[:6]) + (", ..." if len(missing) > 6 else "")
        passed.append(f"{level_name(scene, scene.levels[number])} shows no facet of {len(missing)} piece(s): {shown}")
    raise InputError(
        f"scene {scene.source}: {passed[-1]}; no finer level may be used: make larger pieces, or allow a finer level"
    )


def _missing(scene: Scene, mesh: BodyMesh) -> list[str]:
    """Names of the pieces without a facet on a mesh that has the surface they are of."""
    found = []
    for name, region in scene.patches.items():
        if region.within and not mesh.shows(region) and mesh.shows(replace(region, within=None)):
            found.append(name)
    return found


def _bare(scene: Scene) -> Scene:
    """The scene without places: its meshes are made whether or not they show them."""
    return replace(scene, patches={}, grasps={}, places={}, divide={})


def _edges(entities: NDArray[np.int64]) -> set[tuple[int, int]]:
    pairs = np.sort(np.vstack([entities[:, [i, j]] for i in range(entities.shape[1]) for j in range(i)]), axis=1)
    return {(int(a), int(b)) for a, b in pairs}


class _Surface:
    """Triangles of regions on the coarsest level that shows them; holds the meshes it has made."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._meshes: dict[int, BodyMesh] = {}

    def __call__(self, region: Region, name: str) -> Array:
        """Corners of the triangles of a patch, cut to its piece, shape (k, 3, 3), m."""
        whole = replace(region, within=None)
        number = next((i for i in range(len(self.scene.levels)) if self._mesh(i).shows(whole)), 0)
        mesh = self._mesh(number)
        entities = mesh.select(whole, f"patch {name}")
        if entities.shape[1] != 3:
            raise InputError(f"patch {name}: is made of lines or points; only surfaces are divided")
        corners = mesh.points[entities]
        for axis in range(3):
            lower, upper = (bound[axis] for bound in (_box(region).lower, _box(region).upper))
            corners = corners if lower == -np.inf else _cut(corners, axis, lower)[1]
            corners = corners if upper == np.inf else _cut(corners, axis, upper)[0]
        if not len(corners):
            raise InputError(f"patch {name}: its surface has nothing in the box of `within`")
        return corners

    def _mesh(self, number: int) -> BodyMesh:
        if number not in self._meshes:
            self._meshes[number] = level_mesh(_bare(self.scene), self.scene.levels[number])
        return self._meshes[number]


def _box(region: Region) -> Box:
    return region.within or _EVERYWHERE


def _divided(scene: Scene) -> Scene:
    surface = _Surface(scene)
    problems = Problems(f"scene {scene.source}")
    patches: dict[str, Region] = {}
    for name, region in scene.patches.items():
        if name not in scene.divide:
            patches[name] = region
            continue
        try:
            boxes = _pieces(surface(region, name), _box(region), scene.divide[name])
            patches |= {f"{name}.{i}": replace(region, within=box) for i, box in enumerate(boxes, start=1)}
        except InputError as error:
            problems.add(scene.source, str(error))
        except _TooMany:
            size = f"{scene.divide[name] * 1e3:.4g} mm"
            text = f"patches.{name}: divide = '{size}' makes more than {MOST_PIECES} pieces; choose a larger size"
            problems.add(scene.source, text)
    problems.raise_if_any()
    return replace(scene, patches=patches, divide={})


class _TooMany(Exception):
    pass


def _pieces(triangles: Array, box: Box, size: float) -> list[Box]:
    """Boxes of the pieces of a surface (k, 3, 3), all within `box`."""
    done: list[Box] = []
    waiting = [(triangles, box)]
    while waiting:
        part, where = waiting.pop()
        if np.ptp(part.reshape(-1, 3), axis=0).max() <= _ABOUT * size * (1 + _SAME):
            done.append(where)
        else:
            # The last is taken first: the lower half.
            waiting += reversed(_halved(part, where))
        if len(done) + len(waiting) > MOST_PIECES:
            raise _TooMany
    return done


def _halves(scene: Scene, wanted: Sequence[str]) -> Scene:
    surface = _Surface(scene)
    patches = scene.patches
    for name in wanted:
        patches = replaced(patches, name, _half_regions(scene, name, surface))
    return replace(scene, patches=patches)


def _half_regions(scene: Scene, name: str, surface: _Surface) -> dict[str, Region]:
    if name not in scene.patches:
        raise InputError(f"patch '{name}' is not in scene {scene.source}; {nearest(name, scene.patches)}")
    names = half_names(name)
    for taken in set(names) & set(scene.patches):
        raise InputError(
            f"patch '{name}' cannot be halved: scene {scene.source} has a patch '{taken}' already; rename it"
        )
    region = scene.patches[name]
    parts = _halved(surface(region, name), _box(region))
    return {half: replace(region, within=box) for half, (_, box) in zip(names, parts, strict=True)}


def half_names(name: str) -> tuple[str, str]:
    """Names of the halves of a patch."""
    return f"{name}.1", f"{name}.2"


def replaced(patches: dict[str, Region], name: str, pieces: dict[str, Region]) -> dict[str, Region]:
    """Patches with one replaced, at its place in the order."""
    result: dict[str, Region] = {}
    for other, region in patches.items():
        result |= pieces if other == name else {other: region}
    return result


def _halved(triangles: Array, box: Box) -> list[tuple[Array, Box]]:
    """The two parts of a surface (k, 3, 3), cut at the middle of its longest extent, with their boxes; the lower one first."""
    points = triangles.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    extent = high - low
    axis = int(np.argmax(extent >= extent.max() * (1 - _SAME)))
    at = float((low[axis] + high[axis]) / 2)
    below, above = _cut(triangles, axis, at)
    return [(below, Box(box.lower, _with(box.upper, axis, at))), (above, Box(_with(box.lower, axis, at), box.upper))]


def _with(corner: Sequence[float], axis: int, value: float) -> tuple[float, float, float]:
    x, y, z = (value if i == axis else old for i, old in enumerate(corner))
    return x, y, z


def _cut(triangles: Array, axis: int, at: float) -> tuple[Array, Array]:
    """What of the triangles (k, 3, 3) lies below and above a plane across an axis; a triangle in the plane is above."""
    distance = triangles[:, :, axis] - at
    tolerance = _SAME * max(float(np.ptp(triangles.reshape(-1, 3), axis=0).max()), 1e-300) if len(triangles) else 0.0
    above = (distance >= -tolerance).all(axis=1)
    below = (distance <= tolerance).all(axis=1) & ~above
    crossed = ~above & ~below
    parts = []
    for side, whole in ((-1.0, below), (1.0, above)):
        cut = [
            t
            for corners, d in zip(triangles[crossed], side * distance[crossed], strict=True)
            for t in _clip(corners, d)
        ]
        parts.append(np.concatenate([triangles[whole], np.array(cut).reshape(-1, 3, 3)]))
    return parts[0], parts[1]


def _clip(corners: Array, distance: Array) -> list[Array]:
    """The part of a triangle (3, 3) where the linear `distance` of its corners is positive, as one or two triangles."""
    polygon = []
    for i in range(3):
        j = (i + 1) % 3
        if distance[i] >= 0:
            polygon.append(corners[i])
        if distance[i] * distance[j] < 0:
            polygon.append(corners[i] + (corners[j] - corners[i]) * distance[i] / (distance[i] - distance[j]))
    return [np.array([polygon[0], polygon[k], polygon[k + 1]]) for k in range(1, len(polygon) - 1)]
