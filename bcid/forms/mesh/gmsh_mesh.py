"""Meshes by gmsh: of a `.geo`, or read from a `.msh`. For the child process alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bcid.base.errors import InputError
from bcid.forms.mesh.check import refuse_many
from bcid.forms.mesh.solid_cells import Block, as_simplices, as_tetrahedra

Arrays = dict[str, Any]


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
    program = source.suffix == ".geo"
    if program and finest:
        _refuse_too_many(source, finest, numbers)
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


def _refuse_too_many(source: Path, size: float, numbers: Mapping[str, str]) -> None:
    """Refuse far more elements than can be solved on, by the volume of a coarse mesh where the box around it is large enough."""
    with _opened(source, size, numbers) as gmsh:
        box = gmsh.model.getBoundingBox(-1, -1)
    spans = [high - low for low, high in zip(box[:3], box[3:], strict=True)]
    volume = math.prod(spans)
    with suppress(InputError):
        refuse_many(volume, size, spans)
        return
    with suppress(RuntimeError), _opened(source, max(spans) / 10, numbers) as gmsh:
        gmsh.model.mesh.generate(3)
        volume = sum(gmsh.model.mesh.getElementQualities(gmsh.model.mesh.getElementsByType(4)[0], "volume")) or volume
    refuse_many(volume, size, spans)


def gmsh_arrays(gmsh: Any) -> Arrays:
    """Nodes, tetrahedra and physical groups of gmsh's mesh."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    if len(tags) == 0:
        raise RuntimeError("holds no nodes")
    number = np.full(int(tags.max()) + 1, -1, dtype=np.int64)
    number[tags.astype(np.int64)] = np.arange(len(tags))
    groups: dict[str, list[Block]] = {}
    solid: list[Block] = []
    for dimension, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dimension, tag) or str(tag)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
            found = _blocks(gmsh, dimension, int(entity), number)
            (solid if dimension == 3 else groups.setdefault(name, [])).extend(found)
    if not solid:
        solid = [block for _, entity in gmsh.model.getEntities(3) for block in _blocks(gmsh, 3, entity, number)]
    points = coordinates.reshape(-1, 3)
    cells, notes = as_tetrahedra(points, solid)
    arrays: Arrays = {"points": points, "cells": cells, "notes": np.array(notes, dtype=str)}
    named = {f"group:{name}": as_simplices(blocks) for name, blocks in groups.items()}
    return arrays | {name: part for name, part in named.items() if part is not None}


def _blocks(gmsh: Any, dimension: int, entity: int, number: Any) -> list[Block]:
    """Elements of an entity, by kind; nodes are rows of the array of points."""
    found = []
    for kind, nodes in zip(*gmsh.model.mesh.getElements(dimension, entity)[::2], strict=True):
        name, _, _, count, _, corners = gmsh.model.mesh.getElementProperties(kind)
        if dimension == 3 and corners not in (4, 5, 6, 8):
            raise RuntimeError(f"holds elements of type {name}; bcid needs tetrahedra")
        found.append(Block(dimension, number[nodes.astype(np.int64)].reshape(-1, count), corners))
    return found
