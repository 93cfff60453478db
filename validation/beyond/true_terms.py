"""What acts on a patch of skin that no scene names: terms of the truth, which no formula of the grammar makes.

Each acts on a round patch with a soft edge, which is no Gaussian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import ufl

from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount, Shape

# Width of the edge, in radii.
_EDGE = 0.2
_QUADRATURE = 6


def _patch(point: Point, c: Constants) -> Any:
    """1 inside, 0 outside."""
    away = point.X - ufl.as_vector([c["cx"], c["cy"], c["cz"]])
    beyond = (ufl.sqrt(ufl.inner(away, away) + 1e-20) - c["radius"]) / (_EDGE * c["radius"])
    return (1 - ufl.tanh(ufl.min_value(beyond, 20.0))) / 2


def _skin(point: Point) -> Any:
    domain = ufl.domain.extract_unique_domain(point.X)
    return ufl.Measure("ds", domain=domain, metadata={"quadrature_degree": _QUADRATURE})


_WHERE = (
    *(Shape(f"c{axis}", "m", f"middle, {axis}", default=0.0) for axis in "xyz"),
    Shape("radius", "m", "of the patch", default=0.01, lower=0.0, open_lower=True),
)


def _held(point: Point, c: Constants) -> Any:
    return c["amount"] / 2 * _patch(point, c) * ufl.inner(point.u, point.u) * _skin(point)


def _sucked(point: Point, c: Constants) -> Any:
    kin = point.kin
    return c["amount"] * _patch(point, c) * kin.J * ufl.inner(ufl.inv(kin.F).T * point.N, point.v) * _skin(point)


def _pushed(point: Point, c: Constants) -> Any:
    traction = ufl.as_vector([c["amount"], c["second"], c["third"]])
    return -_patch(point, c) * ufl.inner(traction, point.u) * _skin(point)


def _stopped(point: Point, c: Constants) -> Any:
    out = ufl.max_value(ufl.inner(point.u, point.N), 0.0)
    return c["amount"] / 2 * _patch(point, c) * out**2 * _skin(point)


@dataclass(frozen=True)
class TrueTerm:
    """A term of the truth.

    Attributes:
        effect: what it does.
        families: of the grammar, that are the same kind: on a named surface, which the patch may lie on, or about a place.
        signs: of its amount.
    """

    effect: BodyEffect
    families: frozenset[str]
    signs: tuple[float, ...] = (1.0,)


def _term(
    name: str, about: str, unit: str, scale: float, families: set[str], signs: tuple[float, ...] = (1.0,),
    extra: tuple[str, ...] = (), **function: Callable[[Point, Constants], Any],
) -> TrueTerm:  # fmt: skip
    amounts = tuple(Amount(n, unit, "how much", neutral=0.0, scale=scale) for n in ("amount", *extra))
    symmetric = "work" not in function
    made = BodyEffect(name, (*amounts, *_WHERE), about, acts_on="boundary", symmetric=symmetric, **function)  # type: ignore[arg-type]
    found = frozenset({*families, *(f"{family}_at_a_spot" for family in families)})
    return TrueTerm(made, found, signs)


TERMS = {
    "held patch": _term("held", "springs on a patch of skin", "Pa/m", 1e5, {"spring"}, potential=_held),
    "suction": _term("sucked", "a pressure on a patch of skin", "Pa", 100.0, {"pressure"}, (-1.0, 1.0), work=_sucked),
    "push": _term("pushed", "a dead traction on a patch of skin", "Pa", 100.0, {"traction"}, (1.0,), ("second", "third"),
                  potential=_pushed),
    "stop": _term("stopped", "a patch of skin that cannot move outwards", "Pa/m", 1e5,
                  {"outer_stop", "normal_spring"}, potential=_stopped),
}  # fmt: skip
