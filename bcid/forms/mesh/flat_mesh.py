"""A flat mesh of triangles, and the sheet that it stands for: one layer of tetrahedra on its middle plane.

The layer has the whole thickness and slides on its lower face, as on a plane of symmetry. Its upper face is free, so that the
stress across it vanishes where the state changes little over a thickness: plane stress (Timoshenko & Goodier, Theory of Elasticity,
3rd ed., section 8). Forces are those of the sheet. The lower face stays in its plane: nothing bends, or buckles out of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError
from bcid.forms.mesh.body_mesh import BodyMesh, Cells, Points, cut_entities, halved_edges, triple
from bcid.forms.mesh.solid_cells import Block, as_simplices, as_tetrahedra
from bcid.scene.parts import MID_PLANE

# Nodes of a flat mesh may be off its plane by this part of its size.
_FLAT = 1e-6
_STATE = 'state its thickness, as thickness = "2 mm" in [geometry], or thickness = "unknown"'


@dataclass(frozen=True)
class FlatMesh:
    """Triangles in a plane z = const.

    Attributes:
        points: nodes, shape (nodes, 3), m.
        triangles: node numbers, shape (k, 3).
        groups: node numbers of named triangles (k, 3), lines (k, 2) or points (k, 1).
    """

    points: Points
    triangles: Cells
    groups: dict[str, Cells] = field(default_factory=dict)

    @classmethod
    def of(cls, points: Points, triangles: Cells, groups: Mapping[str, Cells], path: Path) -> FlatMesh:
        """With all triangles turned the same way.

        Raises:
            InputError: it does not lie in a plane z = const, or has a group of the name that the middle plane has.
        """
        if MID_PLANE in groups:
            raise InputError(
                f"{path}: has a physical group '{MID_PLANE}', as the middle plane of a sheet is called; rename it"
            )
        corners = points[triangles]
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        if not high[2] - low[2] <= _FLAT * np.linalg.norm(high - low):
            raise InputError(
                f"{path}: its triangles do not lie in a plane z = const: they span {triple(low * 1e3)} to {triple(high * 1e3)} mm; "
                "turn a flat mesh into such a plane, or mesh a curved body with tetrahedra and leave geometry.thickness out"
            )
        turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0
        return cls(points, np.where(turned[:, None], triangles[:, ::-1], triangles), dict(groups))

    def refined(self) -> FlatMesh:
        """Every triangle cut into four, every line into two."""
        points, triangles = halved_edges(self.points, self.triangles)
        return FlatMesh(points, triangles, cut_entities(self.points, self.triangles, self.groups))

    def extruded(self, thickness: float) -> BodyMesh:
        """The sheet: one layer of tetrahedra of a thickness (m), upwards from its middle plane.

        Lines become strips of its edge. Triangles become parts of its volume, and of both of its faces.
        """
        above = len(self.points)
        points = np.vstack([self.points, self.points + np.array([0.0, 0.0, thickness])])

        def layer(flat: Cells) -> Cells:
            return as_tetrahedra(points, [Block(3, np.c_[flat, flat + above], 6)])[0]

        def boundary(flat: Cells) -> Cells:
            if flat.shape[1] == 3:
                return np.vstack([flat, flat + above])
            if flat.shape[1] == 1:
                return np.c_[flat, flat + above]
            a, b = flat.T
            strip = as_simplices([Block(2, np.c_[a, b, b + above, a + above], 4)])
            assert strip is not None
            return strip

        groups = {name: boundary(flat) for name, flat in self.groups.items()} | {MID_PLANE: self.triangles}
        parts = {name: layer(flat) for name, flat in self.groups.items() if flat.shape[1] == 3}
        return BodyMesh(points, layer(self.triangles), groups, parts)


def require_kind(arrays: Mapping[str, Any], thickness: float | None, path: Path) -> None:
    """A thickness is that of a flat mesh, and a flat mesh has one.

    Args:
        arrays: what a child gave back; "flat" are the triangles of a mesh without solid cells.
        thickness: of the scene, m.
        path: the geometry.

    Raises:
        InputError: one of them is there without the other.
    """
    flat = len(arrays.get("flat", ())) > 0
    if flat and thickness is None:
        raise InputError(
            f"{path}: holds triangles and no tetrahedra; a flat one is a sheet: {_STATE}; "
            "a surface is meshed when it is an STL, PLY or OBJ file"
        )
    if thickness is not None and not flat:
        what = "tetrahedra" if len(arrays["cells"]) else "no triangles"
        raise InputError(
            f"{path}: geometry.thickness is that of a sheet, which is given as a flat mesh of triangles; this one holds {what}: "
            "leave thickness out, or name a 2-D geometry"
        )
