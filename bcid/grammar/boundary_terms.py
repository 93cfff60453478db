"""Families of terms on a named surface, or about a place on the surface: springs, one-sided contact, pressure, traction."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.forms.parameter import Amount, Shape
from bcid.grammar.deformed import Deformed
from bcid.grammar.family import INNER_SPOT, SPOT, SURFACE, Family, Values

Array = NDArray[np.float64]


# Friction is regularised over this part of the body's size, as that of `bcid.forms.effects.support_friction`.
_CREEP = 1e-3
_FRICTION = f"""change, edge = point.u - point.past.u, {_CREEP} * point.size
slid = change - ufl.inner(change, point.N) * point.N
return c['stress'] * point.past.moving * (ufl.sqrt(ufl.inner(slid, slid) + edge**2) - edge)"""


def _slides(d: Deformed, edge: float) -> Array:
    """Direction in which points slide along the surface, shorter than one where they creep, shape (q, 3)."""
    slid = d.since - np.einsum("qi,qi->q", d.since, d.points.normals)[:, None] * d.points.normals
    return np.asarray(slid / np.sqrt(np.einsum("qi,qi->q", slid, slid) + edge**2)[:, None])


def boundary_terms(shear: float, box: Array) -> list[Family]:
    """All families, those of a surface, then those of a spot.

    Args:
        shear: modulus of the body, Pa.
        box: lower and upper corner of its bounding box at rest, shape (2, 3), m.
    """
    named = _named(shear, _size(box))
    return [*named, *(_at_a_spot(family, SPOT, box) for family in named)]


def _size(box: Array) -> float:
    return float(np.linalg.norm(box[1] - box[0]))


def body_forces(shear: float, box: Array) -> list[Family]:
    """Dead forces per volume: the same everywhere, linear in place, or about a place in the body; see `boundary_terms`."""
    size = _size(box)
    unit = 0.05 * shear / size
    uniform = Family(
        "body_force", "body force", "a force acts on all of the body", "-f . u per volume",
        "return -ufl.inner(ufl.as_vector([c['fx'], c['fy'], c['fz']]), point.u)",
        tuple(Amount(f"f{axis}", "N/m^3", f"force along {axis}", neutral=0.0, scale=unit) for axis in "xyz"),
        (), lambda d, v: -np.broadcast_to(np.eye(3), (len(d.J), 3, 3)),
    )  # fmt: skip
    pairs = [(i, j) for i in "xyz" for j in "xyz"]
    rows = ", ".join("[" + ", ".join(f"c['f{i}{j}']" for j in "xyz") + "]" for i in "xyz")

    def linear(d: Deformed, values: Values) -> Array:
        along = (d.points.places - d.centre) / d.size
        return np.asarray(-np.einsum("ij,qk->qijk", np.eye(3), along).reshape(len(along), 3, 9))

    growing = Family(
        "body_force_linear", "body force", "a force acts on the body that changes linearly over it",
        "-(f (X - centre)/size) . u per volume",
        f"force = ufl.as_matrix([{rows}]) * ((point.X - point.centre) / point.size)\nreturn -ufl.inner(force, point.u)",
        tuple(
            Amount(f"f{i}{j}", "N/m^3", f"change along {j} over the body of the force along {i}", neutral=0.0, scale=2 * unit)
            for i, j in pairs
        ),
        (), linear,
    )  # fmt: skip
    return [uniform, growing, _at_a_spot(replace(uniform, about="a force acts"), INNER_SPOT, box)]


def _named(shear: float, size: float) -> list[Family]:
    """Those on a named surface."""
    stiffness = Amount("stiffness", "Pa/m", "per area", lower=0.0, upper=1e9, neutral=0.0, scale=2 * shear / size)

    def spring(name: str, about: str, formula: str, code: str, unit: Callable[[Deformed], Array]) -> Family:
        return Family(
            name, "boundary", about, formula, code, (stiffness,), (), lambda d, v: unit(d)[..., None], SURFACE
        )

    def along(d: Deformed) -> Array:
        return np.asarray(np.einsum("qi,qi->q", d.u, d.points.normals))

    def normal(by: Callable[[Array], Array]) -> Callable[[Deformed], Array]:
        return lambda d: by(along(d))[:, None] * d.points.normals

    across = "across = ufl.inner(point.u, point.N)\n"
    pressure = Amount("pressure", "Pa", "into the body", neutral=0.0, scale=0.02 * shear)
    tractions = tuple(
        Amount(f"t{axis}", "Pa", f"traction along {axis}", neutral=0.0, scale=0.02 * shear) for axis in "xyz"
    )
    return [
        spring("spring", "springs hold it in all directions", "k/2 u^2 per area",
               "return c['stiffness'] / 2 * ufl.inner(point.u, point.u)", lambda d: d.u),
        spring("normal_spring", "springs hold it across the surface", "k/2 (u . N)^2 per area",
               across + "return c['stiffness'] / 2 * across**2", normal(lambda a: a)),
        spring("sliding_spring", "springs hold it along the surface", "k/2 |u - (u . N) N|^2 per area",
               across + "return c['stiffness'] / 2 * (ufl.inner(point.u, point.u) - across**2)",
               lambda d: d.u - along(d)[:, None] * d.points.normals),
        spring("outer_stop", "it is pushed back where it moves outwards", "k/2 max(u . N, 0)^2 per area",
               across + "return c['stiffness'] / 2 * ufl.max_value(across, 0.0) ** 2", normal(lambda a: np.maximum(a, 0.0))),
        spring("inner_stop", "it is pulled back where it moves inwards", "k/2 min(u . N, 0)^2 per area",
               across + "return c['stiffness'] / 2 * ufl.min_value(across, 0.0) ** 2", normal(lambda a: np.minimum(a, 0.0))),
        Family(
            "pressure", "boundary", "a pressure that follows the surface acts", "p J F^-T N . v per area",
            "kin = point.kin\nreturn c['pressure'] * kin.J * ufl.inner(ufl.inv(kin.F).T * point.N, point.v)",
            (pressure,), (),
            lambda d, v: (d.J[:, None] * np.einsum("qij,qj->qi", d.inverse_transposed, d.points.normals))[..., None],
            SURFACE, works=True,
        ),
        Family(
            "traction", "boundary", "a dead traction acts", "-t . u per area",
            "return -ufl.inner(ufl.as_vector([c['tx'], c['ty'], c['tz']]), point.u)",
            tractions, (), lambda d, v: -np.broadcast_to(np.eye(3), (len(d.J), 3, 3)), SURFACE,
        ),
        Family(
            "friction", "boundary", "friction holds it back when it slides", "s |d| per area, d the slide since the last step",
            _FRICTION, (Amount("stress", "Pa", "shear stress while it slides", lower=0.0, neutral=0.0, scale=0.02 * shear),),
            (), lambda d, v: _slides(d, _CREEP * size)[..., None], SURFACE, remembers=True,
        ),
    ]  # fmt: skip


def _at_a_spot(family: Family, where: str, box: Array) -> Family:
    """The same about a place: times a Gaussian. The place is uniform over the box before the data are looked at."""
    size = _size(box)

    def unit(d: Deformed, values: Values) -> Array:
        assert family.unit is not None
        weight = d.spot((values["cx"], values["cy"], values["cz"]), values["radius"])
        return np.asarray(weight[:, None, None] * family.unit(d, values))

    shapes = (
        *(
            Shape(
                f"c{axis}",
                "m",
                f"where, {axis}",
                default=0.0,
                scale=0.1 * size,
                prior=(float(lower + upper) / 2, float(upper - lower) / math.sqrt(12)),
            )
            for axis, lower, upper in zip("xyz", *box, strict=True)
        ),
        Shape(
            "radius",
            "m",
            "how far it reaches",
            default=0.1 * size,
            lower=0.0,
            open_lower=True,
            scale=0.05 * size,
            prior=(0.12 * size, 0.08 * size),
        ),
    )
    return replace(
        family, name=f"{family.name}_at_a_spot", formula=f"w {family.formula}, w = exp(-|X - c|^2/(2 radius^2))",
        unit=unit, where=where, shapes=(*family.shapes, *shapes),
    )  # fmt: skip
