"""Child process that makes or reads a mesh: ``python -m bcid.forms.mesh.child FILE OUT.npz SIZE FINEST [NAME=NUMBER ...]``.

It runs apart because gmsh may abort on damaged files, and runs scripts. Says in one line why a file cannot be used; exits with 1.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import serve
from bcid.base.errors import InputError
from bcid.forms.mesh.check import MOST_CELLS, expected_cells
from bcid.forms.mesh.references import refuse_references

Arrays = dict[str, Any]
_GMSH = (".geo", ".msh")
_GMSH_TYPES = {4: 4, 2: 3, 1: 2, 15: 1}
_MESHIO_TYPES = {3: "triangle", 2: "line", 1: "vertex"}
# Address space, bytes, of a child that meshes so many.
_MESHING_SPACE = 2_000_000_000 + 2_000 * MOST_CELLS


def main() -> int:
    """Read the arguments, write the arrays."""
    suffix = Path(sys.argv[1]).suffix
    libraries = ["gmsh"] if suffix in _GMSH else ["meshio", "h5py"]
    return serve(_read, libraries, _MESHING_SPACE if suffix == ".geo" else None)


def _read(source: Path, arguments: Sequence[str]) -> Arrays:
    if source.suffix in _GMSH:
        numbers = dict(entry.split("=", 1) for entry in arguments[2:])
        return with_gmsh(source, float(arguments[0]), float(arguments[1]), numbers)
    refuse_references(source)
    return with_meshio(source)


def with_gmsh(
    source: Path, size: float = 0.0, finest: float = 0.0, numbers: Mapping[str, str] = MappingProxyType({})
) -> Arrays:
    """Mesh a `.geo`, or read a `.msh`.

    Args:
        source: the file.
        size: of the elements of a `.geo`, in its own unit: its parameter h.
        finest: the smallest size that will be asked for; refused when it makes more elements than can be solved on.
        numbers: other parameters of the `.geo`.
    """
    import gmsh

    program = source.suffix == ".geo"
    if program and finest:
        _refuse_too_many(gmsh, source, finest, numbers)
    with _opened(gmsh, source, size, numbers):
        if program:
            gmsh.model.mesh.generate(3)
        return _gmsh_arrays(gmsh)


@contextmanager
def _opened(gmsh: Any, source: Path, size: float, numbers: Mapping[str, str]) -> Iterator[None]:
    """Have gmsh open a file; its errors are told in its own words."""
    arguments = ["bcid", "-nopopup", "-v", "1"]
    for name, number in {**numbers, **({"h": repr(size)} if size else {})}.items():
        arguments += ["-setnumber", name, number]
    gmsh.initialize(arguments, readConfigFiles=False, run=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.logger.start()
    try:
        gmsh.open(str(source))
        yield
    except InputError:
        raise
    except Exception as error:
        said = [line for line in gmsh.logger.get() if line.startswith("Error")]
        raise RuntimeError(said[0] if said else str(error)) from None
    finally:
        gmsh.finalize()


def _refuse_too_many(gmsh: Any, source: Path, size: float, numbers: Mapping[str, str]) -> None:
    """Refuse far more elements than can be solved on, by the volume of a coarse mesh where the box around it is large enough."""
    with _opened(gmsh, source, size, numbers):
        box = gmsh.model.getBoundingBox(-1, -1)
    spans = [high - low for low, high in zip(box[:3], box[3:], strict=True)]
    volume = math.prod(spans)
    if expected_cells(volume, size) <= MOST_CELLS:
        return
    coarse = max(spans) / 10
    with suppress(RuntimeError), _opened(gmsh, source, coarse, numbers):
        gmsh.model.mesh.generate(3)
        volume = sum(gmsh.model.mesh.getElementQualities(gmsh.model.mesh.getElementsByType(4)[0], "volume")) or volume
    cells = expected_cells(volume, size)
    if cells > MOST_CELLS:
        shown = " x ".join(f"{span:.4g}" for span in spans)
        raise InputError(
            f"elements of {size:.4g} in a body of {shown} (in the unit of the file) are about {cells:.1g} tetrahedra, "
            f"more than {MOST_CELLS:,}; choose larger elements, or mend geometry.length_unit"
        )


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
