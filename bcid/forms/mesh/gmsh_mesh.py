"""Meshes by gmsh: of a `.geo`, or read from a `.msh`. For the child process alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bcid.base.errors import InputError
from bcid.forms.mesh.body_mesh import BodyMesh, volumes
from bcid.forms.mesh.check import MOST_CELLS, expected_cells, layer_cells, refuse_many
from bcid.forms.mesh.length_unit import ROUGH
from bcid.forms.mesh.solid_cells import Block, as_simplices, as_tetrahedra

Arrays = dict[str, Any]
# The box that gmsh makes around a flat geometry is so high, in parts of its length.
_FLAT = 1e-5


def with_gmsh(
    source: Path,
    size: float = 0.0,
    finest: float = 0.0,
    numbers: Mapping[str, str] = MappingProxyType({}),
    most: float = math.inf,
) -> Arrays:
    """Mesh a `.geo`, or read a `.msh`.

    Args:
        source: the file.
        size: of the elements of a `.geo`, in its own unit: its parameter h.
        finest: the smallest size that will be asked for; refused when it makes more elements than can be solved on.
        numbers: other parameters of the `.geo`.
        most: where more elements are expected, a rough mesh is made instead, and marked as "rough".
    """
    program = source.suffix == ".geo"
    if program and size:
        outline = _outline(source, finest or size, numbers)
        _refuse_too_many(outline, finest or size)
        if outline.cells(size) > most and outline.rough is not None:
            return outline.rough | {"rough": np.array(True)}
    with _opened(source, size, numbers) as gmsh:
        if program:
            gmsh.model.mesh.generate(3)
        return gmsh_arrays(gmsh)


@contextmanager
def session(arguments: list[str]) -> Iterator[Any]:
    """gmsh itself, as far as it is begun; its errors are told in its own words."""
    import gmsh

    command = ["bcid", "-nopopup", "-v", "1", *arguments]
    gmsh.initialize(command, readConfigFiles=False, run=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.logger.start()
    try:
        yield gmsh
    except InputError:
        raise
    except Exception as error:
        said = [line for line in gmsh.logger.get() if line.startswith("Error")]
        raise RuntimeError(said[0] if said else str(error)) from None
    finally:
        gmsh.finalize()


@contextmanager
def _opened(source: Path, size: float, numbers: Mapping[str, str]) -> Iterator[Any]:
    """gmsh with a file that it has opened."""
    arguments = []
    for name, number in {**numbers, **({"h": repr(size)} if size else {})}.items():
        arguments += ["-setnumber", name, number]
    with session(arguments) as gmsh:
        gmsh.open(str(source))
        yield gmsh


@dataclass(frozen=True)
class _Outline:
    """What is known of the body of a `.geo` before it is meshed.

    Attributes:
        source, numbers: the file and its parameters.
        spans: of the box around it.
        stated: the largest size of elements that its points ask for themselves; 0 where one of them asks for none.
    """

    source: Path
    numbers: Mapping[str, str]
    spans: list[float]
    stated: float

    def cells(self, size: float) -> float:
        """At most about so many elements of a size, or of that which is stated, are in the box."""
        size = min(size, self.stated or size)
        return (
            layer_cells(self.spans[0] * self.spans[1], size)
            if self.flat
            else expected_cells(math.prod(self.spans), size)
        )

    @property
    def flat(self) -> bool:
        """Whether it lies in a plane z = const."""
        return self.spans[2] <= _FLAT * max(self.spans)

    @cached_property
    def rough(self) -> Arrays | None:
        """Its mesh with elements of a part of its length, whatever it asks for; None if gmsh cannot make it."""
        with suppress(RuntimeError), self.coarse(ROUGH) as gmsh:
            gmsh.model.mesh.generate(3)
            return gmsh_arrays(gmsh)
        return None

    @contextmanager
    def coarse(self, part: float) -> Iterator[Any]:
        """gmsh with the body, and elements of a part of its length."""
        size = part * max(self.spans)
        with _opened(self.source, size, self.numbers) as gmsh:
            for option in ("MeshSizeMin", "MeshSizeMax"):
                gmsh.option.setNumber(f"Mesh.{option}", size)
            yield gmsh

    @property
    def obeys(self) -> bool:
        """Whether sizes decide how many nodes its curves have, which may also be numbered one by one (transfinite)."""
        nodes = []
        for part in (ROUGH, ROUGH / 4):
            with self.coarse(part) as gmsh:
                gmsh.model.mesh.generate(1)
                nodes.append(len(gmsh.model.mesh.getNodes()[0]))
        return nodes[1] > 2 * nodes[0]


def _outline(source: Path, size: float, numbers: Mapping[str, str]) -> _Outline:
    """What opening a `.geo` says of its body."""
    with _opened(source, size, numbers) as gmsh:
        low, high = np.array(gmsh.model.getBoundingBox(-1, -1)).reshape(2, 3)
        sizes = gmsh.model.mesh.getSizes(gmsh.model.getEntities(0))
        least, most, factor, used = (
            gmsh.option.getNumber(f"Mesh.{option}")
            for option in ("MeshSizeMin", "MeshSizeMax", "MeshSizeFactor", "MeshSizeFromPoints")
        )
    stated = float(max(sizes)) if used and len(sizes) and min(sizes) > 0 else 0.0
    return _Outline(source, numbers, (high - low).tolist(), factor * min(max(stated, least), most) if stated else 0.0)


def _refuse_too_many(outline: _Outline, size: float) -> None:
    """Refuse far more elements than can be solved on, by the volume of a rough mesh where the box around it is large enough.

    Where points state sizes of their own the area alone counts: layers of extruded areas may be of any height.
    """
    if outline.cells(size) <= MOST_CELLS:
        return
    if outline.flat:
        refuse_many(outline.cells(size), size, outline.spans)
    volume, area = math.prod(outline.spans), 0.0
    if outline.rough is not None:
        points, cells = outline.rough["points"], outline.rough["cells"]
        volume = float(np.abs(volumes(points, cells)).sum()) or volume
        area = BodyMesh(points, cells).area(BodyMesh(points, cells).boundary)
    refuse_many(expected_cells(volume, size), size, outline.spans)
    if outline.stated and area / outline.stated**2 > MOST_CELLS and outline.obeys:
        refuse_many(area / outline.stated**2, outline.stated, outline.spans)


def gmsh_arrays(gmsh: Any) -> Arrays:
    """Nodes, tetrahedra and physical groups of gmsh's mesh."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    if len(tags) == 0:
        raise RuntimeError("holds no nodes")
    number = np.full(int(tags.max()) + 1, -1, dtype=np.int64)
    number[tags.astype(np.int64)] = np.arange(len(tags))
    groups: dict[str, list[Block]] = {}
    # Of volumes, each once: one of them may be in several groups.
    parts: dict[str, list[Block]] = {}
    volumes: dict[int, list[Block]] = {}
    for dimension, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dimension, tag) or str(tag)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
            found = _blocks(gmsh, dimension, int(entity), number)
            (parts if dimension == 3 else groups).setdefault(name, []).extend(found)
            if dimension == 3:
                volumes[int(entity)] = found
    if not volumes:
        volumes = {int(entity): _blocks(gmsh, 3, entity, number) for _, entity in gmsh.model.getEntities(3)}
    solid = [block for blocks in volumes.values() for block in blocks]
    points = coordinates.reshape(-1, 3)
    cells, notes = as_tetrahedra(points, solid)
    arrays: Arrays = {"points": points, "cells": cells, "notes": np.array(notes, dtype=str)}
    if not len(cells):
        arrays["flat"] = _flat(gmsh, number)
    named = {f"group:{name}": as_simplices(blocks) for name, blocks in groups.items()}
    named |= {f"part:{name}": as_tetrahedra(points, blocks)[0] for name, blocks in parts.items()}
    return arrays | {name: part for name, part in named.items() if part is not None}


def _flat(gmsh: Any, number: Any) -> Any:
    """Triangles (k, 3) of the surfaces: of those in physical groups where there are any."""
    tags = [
        entity
        for _, group in gmsh.model.getPhysicalGroups(2)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(2, group)
    ] or [entity for _, entity in gmsh.model.getEntities(2)]
    found = as_simplices(block for tag in sorted({int(tag) for tag in tags}) for block in _blocks(gmsh, 2, tag, number))
    return np.zeros((0, 3), dtype=np.int64) if found is None else found


def _blocks(gmsh: Any, dimension: int, entity: int, number: Any) -> list[Block]:
    """Elements of an entity, by kind; nodes are rows of the array of points."""
    found = []
    for kind, nodes in zip(*gmsh.model.mesh.getElements(dimension, entity)[::2], strict=True):
        name, _, _, count, _, corners = gmsh.model.mesh.getElementProperties(kind)
        if dimension == 3 and corners not in (4, 5, 6, 8):
            raise RuntimeError(f"holds elements of type {name}; bcid needs tetrahedra")
        found.append(Block(dimension, number[nodes.astype(np.int64)].reshape(-1, count), corners))
    return found
