"""Tetrahedra of a given size inside a closed surface, by gmsh. For the child process alone.

The surface is cut into pieces that can be flattened, along its sharp edges where it has some, and each piece is meshed anew in its
own plane (Remacle, Geuzaine, Compere, Marchandise, High-quality surface remeshing using harmonic maps, IJNME 2010).
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np

from bcid.base.errors import InputError
from bcid.forms.mesh.check import expected_cells, refuse_many
from bcid.forms.mesh.fields import field_arrays
from bcid.forms.mesh.gmsh_mesh import gmsh_arrays, session
from bcid.forms.mesh.length_unit import ROUGH
from bcid.forms.mesh.parts_of_surface import enclosed
from bcid.forms.mesh.surface_file import TriangleSurface

Arrays = dict[str, Any]
# Edges that turn by more are kept, degrees; where a surface cannot be cut along all of them, fewer are, and at last none.
_SHARP = (40.0, 75.0, 180.0)
# A mesh that differs by more from the volume of the surface is told of, or is none.
_TOLD, _WRONG = 0.05, 0.5
# Tetrahedra below this quality (gamma: 1 for a regular one, 0 for a flat one) are moved apart once more.
_POOR = 0.05


def solid(surface: TriangleSurface, size: float, finest: float, most: float = math.inf) -> Arrays:
    """Nodes and tetrahedra of a size, in the unit of the file, with the fields of the surface and what was done to it.

    Args:
        surface: one closed surface that looks outward, with cavities that look inward.
        size: length of the edges.
        finest: the smallest size that will be asked for; refused when it makes more elements than can be solved on.
        most: where more elements are expected, a rough mesh is made instead, and marked as "rough".

    Raises:
        InputError: too many elements, or gmsh cannot mesh it with elements of this size.
    """
    volume = enclosed(surface)
    spans = np.ptp(surface.points, axis=0).tolist()
    refuse_many(expected_cells(volume, finest or size), finest or size, spans)
    if expected_cells(volume, size) > most:
        rough, _ = _first_good(surface, ROUGH * max(spans), volume)
        if rough is not None:
            return rough | {"rough": np.array(True)} | field_arrays(surface.points[surface.triangles], surface.fields)
    arrays, said = _first_good(surface, size, volume)
    if arrays is None:
        unit = ", or mend geometry.length_unit: they are longer than the body" if size > max(spans) else ""
        raise InputError(
            f"the surface ({len(surface.triangles)} triangles, volume {volume:.4g}) cannot be meshed with elements of {size:.4g} "
            f"in the unit of the file: {said}; choose smaller elements than its thinnest part, or smooth the surface{unit}"
        )
    inside = _volume(arrays)
    notes = [*surface.notes, *arrays["notes"].tolist()]
    if abs(inside / volume - 1) > _TOLD:
        notes.append(
            f"elements of {size:.4g} (in the unit of the file) change the volume of the surface by {inside / volume - 1:+.1%}: "
            "choose smaller ones where that matters"
        )
    arrays["notes"] = np.array(notes, dtype=str)
    return arrays | field_arrays(surface.points[surface.triangles], surface.fields)


def _first_good(surface: TriangleSurface, size: float, volume: float) -> tuple[Arrays | None, str]:
    """The first mesh that has about the volume of the surface, or what gmsh said last."""
    said = ""
    for angle in _SHARP:
        try:
            arrays = _meshed(surface, size, angle)
        except RuntimeError as error:
            said = str(error).removeprefix("Error   : ")
            continue
        inside = _volume(arrays)
        if len(arrays["cells"]) and abs(inside / volume - 1) <= _WRONG:
            return arrays, ""
        said = f"what gmsh makes has a volume of {inside:.4g}"
    return None, said


def _volume(arrays: Arrays) -> float:
    a, b, c, d = (arrays["points"][arrays["cells"][:, i]] for i in range(4))
    return float(np.abs(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)).sum() / 6)


def _meshed(surface: TriangleSurface, size: float, angle: float) -> Arrays:
    with session([]) as gmsh:
        mesh = gmsh.model.mesh
        for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
            gmsh.option.setNumber(f"Mesh.{option}", 0)
        for option in ("MeshSizeMin", "MeshSizeMax"):
            gmsh.option.setNumber(f"Mesh.{option}", size)
        whole = gmsh.model.addDiscreteEntity(2)
        mesh.addNodes(2, whole, np.arange(1, len(surface.points) + 1), surface.points.ravel())
        mesh.addElementsByType(whole, 2, [], (surface.triangles + 1).ravel())
        mesh.classifySurfaces(math.radians(angle), True, True, math.pi)
        mesh.createGeometry()
        loops = [gmsh.model.geo.addSurfaceLoop(shell) for shell in _shells(gmsh)]
        gmsh.model.geo.addVolume(loops)
        gmsh.model.geo.synchronize()
        mesh.generate(3)
        tetrahedra = mesh.getElementsByType(4)[0]
        if len(tetrahedra) and min(mesh.getElementQualities(tetrahedra, "gamma")) < _POOR:
            # Not every build of gmsh has it; what is too flat is refused later.
            with suppress(Exception):
                mesh.optimize("Netgen")
        return gmsh_arrays(gmsh)


def _shells(gmsh: Any) -> list[list[int]]:
    """Surfaces that hang together by curves, as lists of tags; those of the outside of the body come first."""
    shells: list[tuple[set[int], list[int]]] = []
    for _, tag in gmsh.model.getEntities(2):
        curves = {abs(int(curve)) for curve in gmsh.model.getAdjacencies(2, tag)[1]}
        joined = [shell for shell in shells if shell[0] & curves]
        shells = [shell for shell in shells if not shell[0] & curves]
        shells.append((curves.union(*(s[0] for s in joined)), [tag, *(t for s in joined for t in s[1])]))
    return sorted((sorted(tags) for _, tags in shells), key=lambda tags: -_extent(gmsh, tags))


def _extent(gmsh: Any, tags: list[int]) -> float:
    boxes = np.array([gmsh.model.getBoundingBox(2, tag) for tag in tags])
    return float(np.linalg.norm(boxes[:, 3:].max(axis=0) - boxes[:, :3].min(axis=0)))
