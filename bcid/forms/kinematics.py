"""Measures of deformation in pure UFL: no mesh, no numbers, only expressions.

Everything a strain energy needs is derived from the deformation gradient F = I + H, H = grad u. Strains are formed
from H and not as the difference C - I, and terms such as I1 - 3 from the strain, so that small deformations keep
their digits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import ufl
from ufl.core.expr import Expr

from bcid.scene.parts import Vector


@dataclass(frozen=True)
class Kinematics:
    """The deformation at a point; build it with `Kinematics.of(u)` or `Kinematics.from_gradient(F)`.

    Attributes:
        H: displacement gradient, 3 x 3.
        F: deformation gradient I + H, 3 x 3.
        axes: unit vectors of the plane of fibres at rest, at 0 and at 90 degrees.
    """

    H: Expr
    F: Expr
    axes: tuple[Vector, Vector]

    @classmethod
    def of(cls, u: Expr, axes: tuple[Vector, Vector]) -> Kinematics:
        """The deformation of a displacement field u (three components, metres)."""
        _require_shape(u, (3,), "displacement")
        H = ufl.grad(u)
        return cls(H, ufl.Identity(3) + H, axes)

    @classmethod
    def from_gradient(cls, F: Expr, axes: tuple[Vector, Vector]) -> Kinematics:
        """The deformation with a given deformation gradient F (3 x 3), for instance the elastic part of one."""
        _require_shape(F, (3, 3), "deformation gradient")
        return cls(F - ufl.Identity(3), F, axes)

    def direction(self, angle: Expr | float) -> Expr:
        """Unit vector in the plane of fibres, at an angle in degrees."""
        radians = angle * (math.pi / 180)
        first, second = (ufl.as_vector(axis) for axis in self.axes)
        return ufl.cos(radians) * first + ufl.sin(radians) * second

    @cached_property
    def C(self) -> Expr:
        """Right Cauchy-Green tensor F^T F."""
        return self.F.T * self.F

    @cached_property
    def E(self) -> Expr:
        """Green-Lagrange strain (C - I)/2, formed from H: no digits are lost at small strain."""
        return (self.H + self.H.T + self.H.T * self.H) / 2

    @cached_property
    def J(self) -> Expr:
        """Volume ratio det F."""
        return ufl.det(self.F)

    @cached_property
    def lnJ(self) -> Expr:
        """Logarithm of the volume ratio (not a number once the material is turned inside out)."""
        return ufl.ln(self.J)

    @cached_property
    def I1_minus_3(self) -> Expr:
        """I1 - 3 = 2 tr E = 2 tr H + H:H."""
        return 2 * ufl.tr(self.H) + ufl.inner(self.H, self.H)

    @cached_property
    def I2_minus_3(self) -> Expr:
        """I2 - 3 = 4 tr E + 2 ((tr E)^2 - E:E)."""
        trace2 = self.I1_minus_3
        return 2 * trace2 + trace2**2 / 2 - 2 * ufl.inner(self.E, self.E)

    @cached_property
    def I1(self) -> Expr:
        """First invariant of C: sum of the squared principal stretches."""
        return 3 + self.I1_minus_3

    @cached_property
    def I2(self) -> Expr:
        """Second invariant of C: ((tr C)^2 - tr C^2)/2."""
        return 3 + self.I2_minus_3

    @cached_property
    def I3(self) -> Expr:
        """Third invariant of C: J^2."""
        return self.J**2

    @cached_property
    def I1bar_minus_3(self) -> Expr:
        """J^(-2/3) I1 - 3: zero at rest and unchanged by a pure change of volume."""
        return _scaled_minus_rest(self.I1, self.I1_minus_3, -2 / 3 * self.lnJ)

    @cached_property
    def I2bar_minus_3(self) -> Expr:
        """J^(-4/3) I2 - 3: zero at rest and unchanged by a pure change of volume."""
        return _scaled_minus_rest(self.I2, self.I2_minus_3, -4 / 3 * self.lnJ)

    @cached_property
    def I1bar(self) -> Expr:
        """First invariant of the isochoric (volume-preserving) part of C: J^(-2/3) I1."""
        return 3 + self.I1bar_minus_3

    @cached_property
    def I2bar(self) -> Expr:
        """Second invariant of the isochoric part of C: J^(-4/3) I2."""
        return 3 + self.I2bar_minus_3

    def invariant4(self, a: Expr) -> Expr:
        """I4 = a . C a: squared stretch of fibres along the unit vector a."""
        return 1 + self.invariant4_minus_1(a)

    def invariant4_minus_1(self, a: Expr) -> Expr:
        """I4 - 1 = 2 a . E a, for a unit vector a."""
        return 2 * ufl.inner(a, self.E * a)

    def invariant4bar_minus_1(self, a: Expr) -> Expr:
        """J^(-2/3) I4 - 1, for a unit vector a."""
        return _scaled_minus_rest(self.invariant4(a), self.invariant4_minus_1(a), -2 / 3 * self.lnJ)

    def invariant5(self, a: Expr) -> Expr:
        """I5 = a . C^2 a = |C a|^2."""
        Ca = self.C * a
        return ufl.inner(Ca, Ca)

    def invariant8(self, a: Expr, b: Expr) -> Expr:
        """I8 = a . C b: coupling of two fibre directions (their shear)."""
        return ufl.inner(a, self.C * b)


def expm1(x: Expr) -> Expr:
    """exp(x) - 1 with all digits at small x (UFL has no expm1)."""
    return 2 * ufl.exp(x / 2) * ufl.sinh(x / 2)


def _scaled_minus_rest(whole: Expr, excess: Expr, exponent: Expr) -> Expr:
    """exp(exponent) whole - rest, for whole = rest + excess, without subtracting the two large numbers."""
    return excess + expm1(exponent) * whole


def _require_shape(expression: Expr, shape: tuple[int, ...], what: str) -> None:
    if expression.ufl_shape != shape:
        raise ValueError(f"the {what} has shape {expression.ufl_shape}; bodies are three-dimensional: expected {shape}")
