"""The mesh of a level: made by gmsh or read from a file, in a child process, then checked and refined."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from bcid.base.collective import Comm, on_root
from bcid.base.confined import read_in_child
from bcid.base.errors import InputError
from bcid.base.fingerprint import file_fingerprint
from bcid.forms.mesh.body_mesh import BodyMesh
from bcid.forms.mesh.check import check_fineness, check_groups, check_places, checked, cut_into, regions
from bcid.forms.mesh.fields import paint
from bcid.forms.mesh.flat_mesh import FlatMesh, require_kind
from bcid.forms.mesh.label_voxels import LabelVoxels
from bcid.forms.mesh.length_unit import check_rough
from bcid.forms.mesh.references import beside
from bcid.scene import Level, Scene
from bcid.scene.geometry_file import PROGRAM, kind_of

Arrays = dict[str, Any]

TIME_LIMIT = 600.0
# Before a mesh of more tetrahedra is made, which takes more than some seconds, the unit of length is checked on a rough one.
MANY = 100_000


def level_mesh(scene: Scene, level: Level, comm: Comm | None = None) -> BodyMesh:
    """Mesh of one level of a scene; collective on `comm` (rank 0 makes it, all get it).

    Raises:
        InputError: the libraries cannot make sense of the geometry, or the mesh is damaged.
    """
    return on_root(comm, lambda: _level_mesh(scene, level))


def _level_mesh(scene: Scene, level: Level) -> BodyMesh:
    size = level.element_size and level.element_size / scene.length_unit
    finest = min((other.element_size for other in (*scene.levels, level) if other.element_size), default=0.0)
    sizes = (size or 0.0, finest / scene.length_unit)
    numbers = {name: repr(value) for name, value in scene.parameters.items()}
    numbers |= {} if scene.label is None else {"label": ",".join(map(str, scene.labels))}
    given = scene.geometry, sizes, tuple(numbers.items()), file_fingerprint(scene.geometry)
    arrays = _load(*given, MANY)
    if "rough" in arrays:
        _check_unit(arrays, scene)
        arrays = _load(*given, math.inf)
    mesh = _body(arrays, scene)
    check_fineness(scene, mesh)
    check_groups(scene, mesh)
    if level.refinements and len(mesh.cells) * cut_into(scene) ** level.refinements > MANY:
        _check_unit(arrays, scene)
    mesh = _refined(mesh, arrays, scene, level.refinements)
    mesh = _painted(mesh, arrays, scene)
    check_places(scene, level_name(scene, level), mesh)
    return mesh


def _refined(mesh: BodyMesh, arrays: Arrays, scene: Scene, times: int) -> BodyMesh:
    """The mesh refined so many times; of a sheet in its plane alone."""
    if times and scene.thickness:
        return _body(arrays, scene, times)
    for _ in range(times):
        mesh = mesh.refined()
    return mesh


def _body(arrays: Arrays, scene: Scene, refinements: int = 0) -> BodyMesh:
    """The mesh that a child gave back, in m; `refinements` are those of a sheet in its plane."""
    require_kind(arrays, scene.thickness, scene.geometry)
    groups = {name[6:]: part for name, part in arrays.items() if name.startswith("group:")}
    parts = {name[5:]: part for name, part in arrays.items() if name.startswith("part:")}
    notes = tuple(map(str, arrays["notes"]))
    points = arrays["points"] * scene.length_unit
    if scene.thickness:
        flat = FlatMesh.of(points, arrays["flat"], groups, scene.geometry)
        for _ in range(refinements):
            flat = flat.refined()
        return checked(flat.extruded(scene.thickness), scene.geometry)
    voxels = LabelVoxels.of(arrays["voxels"], arrays["frame"], scene.length_unit) if "voxels" in arrays else None
    return checked(BodyMesh(points, arrays["cells"], groups, parts, notes=notes, voxels=voxels), scene.geometry)


def _check_unit(arrays: Arrays, scene: Scene) -> None:
    """`check_rough` on a rough mesh, if it is sound: where it is not, a finer one may be."""
    try:
        mesh = _painted(_body(arrays, scene), arrays, scene)
    except InputError:
        return
    check_rough(scene, mesh)


def _painted(mesh: BodyMesh, arrays: Arrays, scene: Scene) -> BodyMesh:
    """The mesh with the fields that its surface is painted with, where the scene asks for one."""
    fields = {name[6:]: values for name, values in arrays.items() if name.startswith("field:")}
    if not fields or not any(region.painted for region in regions(scene)):
        return mesh
    middles = mesh.points[mesh.boundary].mean(axis=1)
    return replace(mesh, paint=paint(arrays["surface"] * scene.length_unit, fields, middles))


def level_name(scene: Scene, level: Level) -> str:
    """A level in words: "level 0 (elements of 50 mm)"."""
    number = f"level {scene.levels.index(level)}" if level in scene.levels else "a level"
    size = (
        f"{level.refinements} refinements"
        if level.element_size is None
        else f"elements of {level.element_size * 1e3:.4g} mm"
    )
    return f"{number} ({size})"


@lru_cache(maxsize=8)
def _load(
    path: Path, sizes: tuple[float, float], numbers: tuple[tuple[str, str], ...], _content: str, most: float
) -> Arrays:
    """Run the loader in a child process: a damaged file may make gmsh abort, and must not take this process along.

    The last results are kept for as long as the content of the file is the same: patches are made and looked for on the
    meshes of several levels before any is solved on.
    """
    program = kind_of(path) == PROGRAM
    if program and path.with_name(path.name + ".opt").exists():
        raise InputError(
            f"{path}.opt: gmsh would run it with {path.name}; take what it sets into {path.name}, and remove it"
        )
    arguments = [*map(repr, (*sizes, most)), *(f"{name}={value}" for name, value in numbers)]
    try:
        return read_in_child(
            "bcid.forms.mesh.child",
            path,
            arguments,
            seconds=TIME_LIMIT,
            beside=beside(path),
            in_place=program,
            check=None if program else refuse_scripts,
        )
    except TimeoutError:
        raise InputError(f"{path}: meshing took more than {TIME_LIMIT:.0f} s; choose larger elements") from None
    except InputError as error:
        raise InputError(f"{path}: cannot be meshed: {error}") from None


def refuse_scripts(path: Path) -> None:
    """Refuse a mesh file that gmsh would take for a script, and run."""
    with path.open("rb") as stream:
        head = stream.read(11)
    if path.suffix == ".msh" and head != b"$MeshFormat":
        raise InputError(
            "does not start with $MeshFormat; gmsh would run it as a script, so it is refused; "
            "save it as a gmsh mesh (format 4.1)"
        )
