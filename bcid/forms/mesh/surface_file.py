"""Surfaces from files: STL (ascii and binary), PLY and OBJ. For the child process alone."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.base.ply_head import refuse_open_head
from bcid.forms.mesh.body_mesh import Cells, Points
from bcid.forms.mesh.fields import of_nodes, of_triangles
from bcid.forms.mesh.foreign_mesh import in_space, read_meshio
from bcid.forms.mesh.solid_cells import triangles as cut

# A binary STL: 80 bytes of anything, the number of triangles, and 50 bytes for each (normal, corners, attribute).
_STL_HEAD = 84
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(rb"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE | re.IGNORECASE)
_NAMED_ENDS = re.compile(rb"^\s*(endfacet|endsolid)", re.MULTILINE | re.IGNORECASE)
_COLOURS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
COLOUR = "colour"


@dataclass(frozen=True)
class TriangleSurface:
    """Triangles in space, as a file has them.

    Attributes:
        points: nodes, shape (nodes, 3), in the unit of the file.
        triangles: shape (k, 3).
        fields: values at the corners of triangles by name, shape (k, 3) or (k, 3, components).
        shared: whether triangles share nodes in this format. In an STL each has its own.
        notes: what was done to it, in sentences.
    """

    points: Points
    triangles: Cells
    fields: dict[str, Any] = field(default_factory=dict)
    shared: bool = True
    notes: tuple[str, ...] = ()


def read_surface(source: Path) -> TriangleSurface:
    """The surface that a file holds.

    Raises:
        InputError: it is truncated, holds no triangles, or is no file of its kind.
    """
    readers = {".stl": _stl, ".ply": _ply, ".obj": _obj}
    surface = readers[source.suffix.lower()](source)
    if len(surface.triangles) == 0:
        raise InputError(
            f"holds {len(surface.points)} points and no triangles: it is no surface; make one of the points first "
            "(as MeshLab's 'Screened Poisson' does), or export the surface with its faces"
        )
    if surface.triangles.min() < 0 or surface.triangles.max() >= len(surface.points):
        raise InputError(f"a triangle names a point that is not among the {len(surface.points)}: the file is damaged")
    return surface


def _stl(source: Path) -> TriangleSurface:
    content = source.read_bytes()
    stated = int.from_bytes(content[80:_STL_HEAD], "little") if len(content) >= _STL_HEAD else -1
    length = _STL_HEAD + stated * _STL_TRIANGLE.itemsize
    # Binary files may begin with "solid" as well: what tells them apart is their length.
    if len(content) != length and _VERTEX.search(content):
        return _soup(_ascii_corners(content))
    if stated < 0 or len(content) < length:
        held = max(0, len(content) - _STL_HEAD) // _STL_TRIANGLE.itemsize
        text = f"states {stated} triangles and holds {held}" if stated >= 0 else f"has {len(content)} bytes"
        raise InputError(f"{text}: it is truncated, or no STL file; export it once more")
    return _soup(np.frombuffer(content, _STL_TRIANGLE, stated, _STL_HEAD)["corners"].astype(float))


def _ascii_corners(content: bytes) -> Points:
    try:
        corners = np.array(_VERTEX.findall(content), dtype="S64").astype(float)
    except ValueError as error:
        raise InputError(f"a vertex is no three numbers ({error}); export it once more") from None
    ends = [word.lower() for word in _NAMED_ENDS.findall(content)]
    if len(corners) % 3 or ends.count(b"endfacet") * 3 != len(corners) or b"endsolid" not in ends:
        raise InputError(
            f"holds {len(corners)} vertices in {ends.count(b'endfacet')} facets: it is truncated; export it once more"
        )
    return corners.reshape(-1, 3, 3)


def _soup(corners: Points) -> TriangleSurface:
    """A surface of triangles (k, 3, 3) that share no nodes."""
    return TriangleSurface(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), shared=False)


def _ply(source: Path) -> TriangleSurface:
    refuse_open_head(source)
    try:
        mesh = read_meshio(source)
    except InputError:
        raise
    except Exception as error:
        said = f": {error}" if str(error) else ""
        raise InputError(f"is truncated, or no PLY file (meshio says {type(error).__name__}{said})") from None
    faces = [
        (number, block) for number, block in enumerate(mesh.cells) if block.data.ndim == 2 and block.data.shape[1] > 2
    ]
    parts, fields = [], []
    for number, block in faces:
        own = {name: values[number] for name, values in mesh.cell_data.items()}
        for part in cut(block.data.astype(np.int64)):
            parts.append(part)
            fields.append(own)
    triangles = np.vstack([np.zeros((0, 3), dtype=np.int64), *parts])
    sound = len(triangles) and triangles.min() >= 0 and triangles.max() < len(mesh.points)
    nodal = _with_colour(mesh.point_data) if sound else {}
    found = {name: of_nodes(values, triangles) for name, values in nodal.items()}
    for name in mesh.cell_data if fields else ():
        found[name] = of_triangles(np.concatenate([np.asarray(own[name]) for own in fields]))
    return TriangleSurface(in_space(mesh.points), triangles, found)


def _with_colour(data: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Fields with three channels of a colour as one field besides, from 0 to 255."""
    found = dict(data)
    for names in _COLOURS:
        if set(names) <= set(data):
            channels = np.stack([np.asarray(data[name]) for name in names], axis=1)
            whole = np.issubdtype(channels.dtype, np.integer)
            found[COLOUR] = channels.astype(float) * (1.0 if whole else 255.0)
    return found


def _obj(source: Path) -> TriangleSurface:
    """Vertices with or without colours, and faces of any number of corners; all else is passed over."""
    points, colours, faces, damaged = [], [], [], 0
    for line in source.read_text("utf-8", "replace").splitlines():
        key, *words = line.split() or [""]
        try:
            if key == "v":
                numbers = [float(word) for word in words]
                points.append(numbers[:3] if len(numbers) > 2 else [np.nan] * 3)
                colours.append(numbers[3:6] if len(numbers) >= 6 else [np.nan] * 3)
            elif key == "f":
                corners = [int(word.split("/")[0]) for word in words]
                faces.append([one - 1 if one > 0 else len(points) + one for one in corners])
        except ValueError:
            damaged += 1
    if damaged:
        raise InputError(f"{damaged} vertices or faces are no numbers: the file is damaged; export it once more")
    triangles = np.array([(f[0], f[i], f[i + 1]) for f in faces for i in range(1, len(f) - 1)], dtype=np.int64).reshape(
        -1, 3
    )
    shades = np.array(colours, dtype=float).reshape(-1, 3)
    fields = {}
    if len(triangles) and np.isfinite(shades).any() and triangles.min() >= 0 and triangles.max() < len(points):
        fields[COLOUR] = of_nodes(shades * (255.0 if np.nanmax(shades) <= 1 else 1.0), triangles)
    return TriangleSurface(np.array(points, dtype=float).reshape(-1, 3), triangles, fields)
