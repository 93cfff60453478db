"""What a scene has slightly wrong, as effects: how large the body is, where patches end, how it stiffens, where it is gripped.

They are made as the effects of the catalogue are, so that their sensitivities come from the same forms. A body that at
rest is X + e V(X), where the scene has X, stores the law's energy at I + grad u . G per volume dX / det G, with
G = I - e grad V to first order in e. A field V that lies in a patch moves where the patch ends (Sokolowski & Zolesio,
Introduction to Shape Optimization, 1992, section 2.9).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ufl
from numpy.typing import NDArray
from ufl.geometry import CellVertices

from bcid.forms.effects.effect import BodyEffect, GripEffect, Point
from bcid.forms.mesh.body_mesh import BodyMesh, volumes
from bcid.forms.model import Term
from bcid.forms.parameter import Amount, Shape
from bcid.measurement import Action
from bcid.scene import Region
from bcid.scene.rotation import as_quaternion, as_rotation, from_vector

Array = NDArray[np.float64]
_AXES = "xyz"
# A region goes through the body along an axis where it has more than this part of its extent.
_THROUGH = 0.9


def _vector(c: Mapping[str, Any], name: str) -> Any:
    return ufl.as_vector([c[f"{name}{axis}"] for axis in _AXES])


def _extent(_point: Point, c: Mapping[str, Any]) -> Any:
    direction = _vector(c, "d")
    return ufl.Identity(3) - c["part"] * ufl.outer(direction, direction)


dimension = BodyEffect(
    name="dimension",
    parameters=(
        Amount("part", "1", "by which the body is larger", neutral=0.0, scale=0.02),
        *(Shape(f"d{axis}", "1", f"direction, {axis}") for axis in _AXES),
    ),
    about="the body is larger than the scene says",
    acts_on="boundary",
    reshaped=_extent,
)


def _part_moved(
    along: Any, distance: Any, c: Mapping[str, Any], most: Callable[..., Any], exp: Callable[..., Any]
) -> Any:
    """How far a point is moved with a border, per distance: so far from the middle of the patch, and so far along the direction."""
    beyond = most(distance - c["radius"], 0.0) / c["fading"]
    return (c["shift"] + c["stretch"] * along / c["reach"]) * exp(-0.5 * beyond**2)


def _patch_moved(point: Point, c: Mapping[str, Any]) -> Any:
    middle, direction = _vector(c, "c"), _vector(c, "d")

    def moved(place: Any) -> Any:
        away = place - middle
        distance = ufl.sqrt(ufl.inner(away, away) + 1e-12 * point.size**2)
        return _part_moved(ufl.inner(away, direction), distance, c, ufl.max_value, ufl.exp) * direction

    return ufl.Identity(3) - c["distance"] * _corners_moved(point.X, moved)


def _corners_moved(X: Any, moved: Callable[[Any], Any]) -> Any:
    """Gradient of a movement of a mesh whose corners move by a field, and whose cells stay affine.

    It is the same all over a cell, so that the points at which the law is integrated do for it, and give the derivative of the
    discrete solution. At other points a law that locks stores energies that no equilibrium has seen.
    """
    domain = ufl.domain.extract_unique_domain(X)
    corners, inverse = CellVertices(domain), ufl.JacobianInverse(domain)
    first, *others = (moved(ufl.as_vector([corners[k, i] for i in range(3)])) for k in range(4))
    parts = [ufl.outer(other - first, inverse[k, :]) for k, other in enumerate(others)]
    return sum(parts[1:], start=parts[0])


def moved_with(border: Term, places: Array) -> Array:
    """How far the body is moved at places (n, 3), m, where a border lies further out by a unit, shape (n, 3)."""
    middle, direction = (np.array([border.values[f"{name}{axis}"] for axis in _AXES]) for name in "cd")
    away = places - middle
    distance = np.linalg.norm(away, axis=1)
    return np.asarray(_part_moved(away @ direction, distance, border.values, np.maximum, np.exp)[:, None] * direction)


border = BodyEffect(
    name="border",
    parameters=(
        Amount("distance", "m", "by which the border lies further out", neutral=0.0, scale=1e-3),
        Shape("shift", "1", "share of it that moves the whole patch"),
        Shape("stretch", "1", "share of it that moves opposite borders apart"),
        *(Shape(f"d{axis}", "1", f"direction, {axis}") for axis in _AXES),
        *(Shape(f"c{axis}", "m", f"middle of the patch, {axis}") for axis in _AXES),
        Shape("reach", "m", "half the patch's extent along the direction"),
        Shape("radius", "m", "distance from the middle up to which everything moves"),
        Shape("fading", "m", "distance over which the movement ends beyond it"),
    ),
    about="a patch ends elsewhere than the scene says",
    acts_on="boundary",
    reshaped=_patch_moved,
)


# Of the shear modulus a part goes with the second invariant that is so many times as uncertain as the coefficient of (I1bar - 3)^2:
# of rubbers a tenth to a third does (Treloar, The Physics of Rubber Elasticity, 1975, chapter 10).
SECOND_INVARIANT = 4.0


def _another_form(point: Point, c: Mapping[str, Any]) -> Any:
    first, second = point.kin.I1bar_minus_3, point.kin.I2bar_minus_3
    return point.shear * (c["part"] * first**2 + c["second"] * SECOND_INVARIANT / 2 * (second - first))


law_form = BodyEffect(
    name="law_form",
    parameters=(
        Amount("part", "1", "coefficient of (I1bar - 3)^2 in shear moduli", neutral=0.0, scale=0.05),
        Amount(
            "second",
            "1",
            "part of the shear modulus that goes with the second invariant, by four",
            neutral=0.0,
            scale=0.05,
        ),
    ),
    about="the law has another form at large strains than the scene says",
    acts_on="material",
    energy=_another_form,
)


def _misplaced(action: Action, values: Mapping[str, float]) -> Action:
    """What the gripper really did: from step 1 on it is off by the same everywhere."""
    if not action.grasp:
        return action
    moving = (action.steps > 0)[:, None]
    turn = as_rotation(from_vector([values[f"r{axis}"] for axis in _AXES]))
    turned = as_quaternion(turn * as_rotation(action.rotation))
    shift = np.array([values[axis] for axis in _AXES])
    return replace(
        action,
        translation=action.translation + np.where(moving, shift, 0.0),
        rotation=np.where(moving, turned, action.rotation),
    )


grip = GripEffect(
    name="grip",
    parameters=(
        *(Amount(axis, "m", f"error of the gripper's place along {axis}", neutral=0.0, scale=1e-3) for axis in _AXES),
        *(Amount(f"r{axis}", "deg", f"error of its turn about {axis}", neutral=0.0, scale=1.0) for axis in _AXES),
    ),
    about="the gripper is not where it is reported to be",
    drive=_misplaced,
)


def _by_other_pixels(action: Action, values: Mapping[str, float]) -> Action:
    """What the gripper does in lengths of the scene, where true lengths are larger than these.

    Its path is shorter in them, but where the same pictures show it, and dead loads are smaller for areas that are: both to first
    order in the part.
    """
    path = 1 - values["part"] * values["known"]
    loads = {place: load * (1 - 2 * values["part"]) for place, load in action.loads.items()}
    return replace(action, translation=action.translation * path, loads=loads)


pixel = GripEffect(
    name="pixel",
    parameters=(
        Amount("part", "1", "by which all lengths from pictures are larger", neutral=0.0, scale=0.02),
        Shape("known", "1", "1 where the gripper's path is known without these pictures, else 0"),
    ),
    about="a pixel is longer than the scene says",
    drive=_by_other_pixels,
)


@dataclass(frozen=True)
class Outline:
    """A patch, where the body is gripped, or a region of the body, as far as the scene may have its border wrong.

    Attributes:
        middle: of its surface or volume, shape (3,), m.
        axes: its two long axes, shape (2, 3), or those of a volume along which it does not go through the whole body.
        reaches: half its extent along each of them, m.
    """

    middle: Array
    axes: Array
    reaches: Array

    @classmethod
    def of(cls, mesh: BodyMesh, region: Region, name: str) -> Outline | None:
        """Of a region of a mesh; None where that is no surface."""
        facets = mesh.select(region, name)
        if facets.shape[1] != 3:
            return None
        corners = mesh.points[facets]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        middle = np.average(corners.mean(axis=1), axis=0, weights=area)
        away = corners.reshape(-1, 3) - middle
        axes = np.linalg.svd(away * np.sqrt(np.repeat(area, 3))[:, None], full_matrices=False)[2][:2]
        return cls(middle, axes, np.abs(away @ axes.T).max(axis=0))

    @classmethod
    def of_volume(cls, mesh: BodyMesh, shares: Array) -> Outline | None:
        """Of a region that has these shares of cells; None where it ends nowhere inside of the body."""
        inside = shares > 0.5
        if not inside.any():
            return None
        corners = mesh.points[mesh.cells]
        middle = np.average(corners.mean(axis=1), axis=0, weights=shares * volumes(mesh.points, mesh.cells))
        away = corners[inside].reshape(-1, 3) - middle
        axes = np.linalg.svd(away, full_matrices=False)[2]
        reaches, whole = np.abs(away @ axes.T).max(axis=0), np.ptp(mesh.points @ axes.T, axis=0) / 2
        ends = reaches < _THROUGH * whole
        return cls(middle, axes[ends], reaches[ends]) if ends.any() else None

    def terms(self, grasp: str = "") -> list[Term]:
        """Every way in which its border may be off: along each axis, both ends together and apart; of a grasp, that of its name."""
        found = []
        for axis, reach in zip(self.axes, self.reaches, strict=True):
            values = {f"d{name}": float(v) for name, v in zip(_AXES, axis, strict=True)}
            values |= {f"c{name}": float(v) for name, v in zip(_AXES, self.middle, strict=True)}
            values |= {"distance": 0.0, "reach": float(reach), "radius": float(np.linalg.norm(self.reaches))}
            values |= {"fading": float(self.reaches.min())}
            for way in ("shift", "stretch"):
                ways = {"shift": 0.0, "stretch": 0.0, way: 1.0}
                found.append(Term(border, values | ways, place=grasp))
        return found


def dimensions() -> list[Term]:
    """The body's extent along each axis."""
    return [Term(dimension, {"part": 0.0} | {f"d{name}": float(name == axis) for name in _AXES}) for axis in _AXES]


def law_form_term() -> Term:
    """The form of the law."""
    return Term(law_form, {"part": 0.0, "second": 0.0})


def grip_term() -> Term:
    """The gripper's place and turn."""
    return Term(grip, {p.name: 0.0 for p in grip.parameters})


def pixel_term(path_known: bool) -> Term:
    """The length of a pixel; whether the gripper's path is known without the pictures."""
    return Term(pixel, {"part": 0.0, "known": float(path_known)})
