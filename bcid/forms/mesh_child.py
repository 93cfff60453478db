"""Child process that makes or reads a mesh: ``python -m bcid.forms.mesh_child FILE OUT.npz ELEMENT_SIZE [NAME=NUMBER ...]``.

It runs apart because gmsh may abort on damaged files. Prints one line and exits with 1 when the file cannot be used.
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, Any]
_GMSH_TYPES = {4: 4, 2: 3, 1: 2, 15: 1}
# Address space of a loader, bytes, and how much more a byte of the file may take.
_SPACE = 2_000_000_000
_PER_BYTE = 100
_MESHIO_TYPES = {3: "triangle", 2: "line", 1: "vertex"}


def main() -> int:
    """Read the arguments, write the arrays."""
    source, out, size = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    numbers = {"h": repr(size)} if size else {}
    numbers |= dict(entry.split("=", 1) for entry in sys.argv[4:])
    limit_memory(source)
    try:
        arrays = with_gmsh(source, numbers) if source.suffix in (".geo", ".msh") else with_meshio(source)
    except Exception as error:
        print(str(error).strip().replace("\n", " ") or type(error).__name__)
        return 1
    np.savez(out, **arrays)
    return 0


def limit_memory(source: Path) -> None:
    """A damaged mesh file may ask for any amount of memory: it gets no more than a sound one of its length needs."""
    if source.suffix != ".geo":
        most = _SPACE + _PER_BYTE * source.stat().st_size
        resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))


def with_gmsh(source: Path, numbers: dict[str, str]) -> Arrays:
    """Mesh a `.geo` with these numbers set (the element size is its parameter h), or read a `.msh`."""
    import gmsh

    arguments = ["bcid", "-nopopup", "-v", "1"]
    for name, number in numbers.items():
        arguments += ["-setnumber", name, number]
    gmsh.initialize(arguments, readConfigFiles=False, run=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.logger.start()
    try:
        gmsh.open(str(source))
        if source.suffix == ".geo":
            gmsh.model.mesh.generate(3)
        return _gmsh_arrays(gmsh)
    except Exception as error:
        said = [line for line in gmsh.logger.get() if line.startswith("Error")]
        raise RuntimeError(said[0] if said else str(error)) from None
    finally:
        gmsh.finalize()


def _gmsh_arrays(gmsh) -> Arrays:  # type: ignore[no-untyped-def]
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    if len(tags) == 0:
        raise RuntimeError("holds no nodes")
    number = np.full(int(tags.max()) + 1, -1, dtype=np.int64)
    number[tags.astype(np.int64)] = np.arange(len(tags))
    groups: dict[str, list[NDArray]] = {}
    cells: list[NDArray] = []
    for dimension, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dimension, tag) or str(tag)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
            found = [number[part] for part in _elements(gmsh, dimension, int(entity))]
            (cells if dimension == 3 else groups.setdefault(name, [])).extend(found)
    if not cells:
        cells = [number[part] for _, entity in gmsh.model.getEntities(3) for part in _elements(gmsh, 3, entity)]
    arrays = {"points": coordinates.reshape(-1, 3), "cells": np.vstack(cells) if cells else np.zeros((0, 4), np.int64)}
    return arrays | {f"group:{name}": np.unique(np.vstack(parts), axis=0) for name, parts in groups.items() if parts}


def _elements(gmsh, dimension: int, entity: int) -> list[NDArray]:  # type: ignore[no-untyped-def]
    types, _, nodes = gmsh.model.mesh.getElements(dimension, entity)
    unknown = [gmsh.model.mesh.getElementProperties(t)[0] for t in types if t not in _GMSH_TYPES]
    if unknown:
        raise RuntimeError(f"holds elements of type {unknown[0]}; bcid needs linear tetrahedra")
    return [n.astype(np.int64).reshape(-1, _GMSH_TYPES[t]) for t, n in zip(types, nodes, strict=True)]


def with_meshio(source: Path) -> Arrays:
    """Read a foreign mesh; its cell sets and gmsh-like tags become groups."""
    import meshio

    try:
        mesh = meshio.read(source)
    except SystemExit:
        raise RuntimeError(f"meshio does not know the format of '{source.name}'") from None
    if "tetra" not in mesh.cells_dict:
        kinds = ", ".join(mesh.cells_dict) or "none"
        raise RuntimeError(f"holds no linear tetrahedra (cell types: {kinds})")
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    arrays: Arrays = {"points": points, "cells": mesh.cells_dict["tetra"].astype(np.int64)}
    for name, sets in mesh.cell_sets_dict.items():
        for kind in _MESHIO_TYPES.values():
            if kind in sets:
                arrays[f"group:{name}"] = mesh.cells_dict[kind][sets[kind]].astype(np.int64)
    return arrays


if __name__ == "__main__":
    sys.exit(main())
