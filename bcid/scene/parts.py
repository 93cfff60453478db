"""What a scene is made of: mesh levels, regions of the boundary, grasps, the material, and what a robot may do."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.kriging import Kriging

Values = dict[str, Any]
Vector = tuple[float, float, float]
# Name of the middle plane of a sheet: what is held along z without being stated in [held].
MID_PLANE = "mid_plane"
# Directions of a surface along which a candidate patch may hold.
SURFACE_DIRECTIONS = ("normal", "tangent")
# A sheet of unknown thickness is computed with this one, m.
COMPUTED_THICKNESS = 1e-3


def horizontal(down: Vector) -> tuple[Vector, Vector]:
    """Unit vectors across a direction: the x axis as far as it lies across (the y axis where it does not), and one to its left."""
    up = -np.asarray(down, dtype=float)
    along = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.99 else np.array([0.0, 1.0, 0.0])
    first = along - (along @ up) * up
    first /= np.linalg.norm(first)
    second = np.cross(first, up)
    return _vector(first), _vector(second)


def _vector(values: NDArray[np.float64]) -> Vector:
    # Without negative zeros, so that equal planes are equal in every way.
    x, y, z = (float(v) + 0.0 for v in values)
    return x, y, z


@dataclass(frozen=True)
class Level:
    """One rung of the mesh ladder.

    `element_size` (m) drives a `.geo` file, a surface or a label image; of a mesh file `refinements` counts the uniform ones.
    `degree` is the polynomial degree of the displacement, 1 or 2 (3 only in code: to tell errors of
    meshes, and for reference solutions).
    """

    degree: int = 1
    element_size: float | None = None
    refinements: int = 0


@dataclass(frozen=True)
class Box:
    """Boundary facets whose corners all lie in a box (m), and on a plane if one is given."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


@dataclass(frozen=True)
class Plane:
    """Boundary facets whose corners all lie on a plane through `point` (m) with `normal`."""

    point: tuple[float, float, float]
    normal: tuple[float, float, float]


@dataclass(frozen=True)
class Sphere:
    """Boundary facets whose middle lies in a sphere (m)."""

    centre: Vector
    radius: float


@dataclass(frozen=True)
class Facing:
    """Boundary facets whose outward normal is within an angle (deg) of the unit vector `normal`."""

    normal: Vector
    within: float


@dataclass(frozen=True)
class Painted:
    """Boundary facets at whose middle more than half of the surface is painted with a value of a field of the geometry's file.

    `value` is one number, or the three of a colour from 0 to 255.
    """

    field: str
    value: tuple[float, ...]


@dataclass(frozen=True)
class Region:
    """Part of the boundary: physical groups of the mesh, and/or the facets that every criterion given takes.

    Of these, `within` takes the facets whose middle m has lower <= m < upper on every axis (m; infinite where nothing is
    cut off). Boxes that tile the space so take every facet of every mesh exactly once.
    """

    groups: tuple[str, ...] = ()
    box: Box | None = None
    plane: Plane | None = None
    within: Box | None = None
    sphere: Sphere | None = None
    facing: Facing | None = None
    painted: Painted | None = None


@dataclass(frozen=True)
class Polygon:
    """All that lies inside a closed polygon of corners (m), seen along a unit vector."""

    corners: tuple[Vector, ...]
    along: Vector


@dataclass(frozen=True)
class BodyRegion:
    """Part of the volume: physical volumes of the mesh, and/or what lies in every shape that is given.

    Attributes:
        volumes: names of physical volumes.
        box, sphere, outline: shapes.
        label: number that it has in a label image; None where it has none.
        ratio: its stiffness to that of the rest of the body; None where that is not known.
        constants: of the law, as written, that are its own; those of the body hold for the others.
    """

    volumes: tuple[str, ...] = ()
    box: Box | None = None
    sphere: Sphere | None = None
    outline: Polygon | None = None
    ratio: float | None = None
    label: int | None = None
    constants: Values = field(default_factory=dict)


# Fewer points drive nothing.
LEAST_POINTS = 3


@dataclass(frozen=True)
class Driven:
    """How a place moves that measured points drive: those that are named, or all that are near.

    Attributes:
        markers: names of fiducials.
        near: all fiducials that are not further away than this, m; None where they are named.
        along: axes along which it is driven; it is free along the others.
        points: where they are at rest, m; none before a measurement is known. With them goes:
        length, ratio, scale, offset: see `bcid.base.kriging.Kriging`, and the standard deviation of where they are at rest, m.
    """

    markers: tuple[str, ...] = ()
    near: float | None = None
    along: tuple[int, ...] = (0, 1, 2)
    points: tuple[Vector, ...] = ()
    length: float = 0.0
    ratio: float = 0.0
    scale: float = 0.0
    offset: float = 0.0

    @cached_property
    def kriging(self) -> Kriging:
        """What makes displacements of the points those of the place."""
        return Kriging(np.array(self.points), self.length, self.ratio, self.scale)


@dataclass(frozen=True)
class Grasp:
    """Where the gripper holds the body, and the centre (m) about which it turns."""

    region: Region
    centre: tuple[float, float, float]


@dataclass(frozen=True)
class Material:
    """Name of a law, its constants as written (units are the law's business), the formulation, and the form of its volumetric
    energy ("": the law's own).
    """

    law: str
    values: Values
    formulation: str = "displacement"
    volumetric: str = ""


@dataclass(frozen=True)
class Limits:
    """What a robot may do to the body, and what it costs.

    Attributes:
        displacement: the gripper's distance from rest is never larger, m.
        force: of the gripper, N; None for no limit.
        strain: largest principal strain (stretch - 1, either sign) that 99 % of the volume may reach; None for no limit.
        amplitudes: how far a pull may go, m, the largest first.
        directions: unit vectors by name.
        steps: of a pull, to its end; as many lead back to rest.
        cost: of one pull.
        regrasp: what changing the grasp costs besides.
    """

    displacement: float
    force: float | None = None
    strain: float | None = None
    amplitudes: tuple[float, ...] = ()
    directions: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    steps: int = 4
    cost: float = 1.0
    regrasp: float = 0.0
