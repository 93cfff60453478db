"""An effect: something physical that a plain hyperelastic body lacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bcid.errors import nearest
from bcid.forms.parameter import Parameter

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from bcid.forms.kinematics import Kinematics

Constants = Mapping[str, Any]


@dataclass(frozen=True)
class Point:
    """What an effect may use at a material point; everything is UFL.

    Attributes:
        u: displacement, m.
        v: virtual displacement.
        kin: deformation measures of u.
        X: rest position, m.
        N: outward normal in the rest state (on the boundary).
        down: unit vector of gravity.
        surface: measure of a named place, ``surface(name)``, m^2 in the rest state.
    """

    u: Expr
    v: Expr
    kin: Kinematics
    X: Expr
    N: Expr
    down: Expr
    surface: Callable[[str], Any]


@dataclass(frozen=True)
class Effect:
    """One effect of the catalogue.

    At the neutral value of every parameter it must vanish. `energy` is per rest volume (J/m^3) and joins the strain
    energy; `work` is a form, the virtual work that the effect adds to the residual, for what has no energy or acts on
    the boundary.

    Attributes:
        name: name of its file, used in scenes, tables and JSON.
        parameters: each with unit, neutral value and bounds.
        symmetric: False when the tangent of `work` is not symmetric (a follower load).
    """

    name: str
    parameters: tuple[Parameter, ...]
    about: str
    energy: Callable[[Point, Constants], Expr] | None = None
    work: Callable[[Point, Constants], Any] | None = None
    symmetric: bool = True

    def check(self, values: Mapping[str, object]) -> list[str]:
        """Problems of parameter values, one readable line each."""
        known = {parameter.name: parameter for parameter in self.parameters}
        problems = [f"unknown parameter '{name}'; {nearest(name, known)}" for name in values if name not in known]
        problems += [
            f"parameter '{name}' is missing" for name, p in known.items() if name not in values and p.default is None
        ]
        checks = (known[name].check(value) for name, value in values.items() if name in known)
        return [f"{self.name}: {problem}" for problem in [*problems, *checks] if problem]
