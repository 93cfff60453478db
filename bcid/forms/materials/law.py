"""A material law: a strain energy, its parameters, and how it resists a change of volume."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

from bcid.base.errors import InputError, nearest
from bcid.forms.parameter import Parameter

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from bcid.forms.kinematics import Kinematics

Scalar = Any
"""A number or a scalar UFL expression."""

Constants = Mapping[str, Scalar]
"""Value of every parameter by name."""

Volumetric = Literal["log", "simo_taylor", "quadratic"]
"""How the energy U depends on the volume ratio J, see `Law`."""

VOLUMETRIC: tuple[Volumetric, ...] = get_args(Volumetric)
"""All of them. The mixed formulation has no "simo_taylor"."""


LARGEST_POISSON = 0.495
"""Largest Poisson's ratio that a fit may give the displacement formulation: beyond it quadratic elements lock."""

LEAST_MIXED_POISSON = 0.01
"""Least one of the mixed formulation, whose bulk term vanishes at 0."""


@dataclass(frozen=True)
class Law:
    """A hyperelastic law: stresses and tangents follow from its energy by UFL differentiation.

    In the displacement form the total strain energy per rest volume is energy + U(J), with

        "log":          U = bulk/2 (ln J)^2
        "simo_taylor":  U = bulk/4 (J^2 - 1 - 2 ln J)   (Simo & Taylor, Comput. Methods Appl. Mech. Eng. 51, 1985, 177)
        "quadratic":    U = bulk/2 (J - 1)^2

    Args:
        name: word used in scene files; the name of the law's file.
        title: name for people.
        parameters: the numbers of the law.
        energy: strain energy density (Pa) without U, from the kinematics and the value of every parameter.
        bulk: factor of U (Pa), or None if `energy` is complete.
        compliance: 1/bulk, written so that it is zero and differentiable for an incompressible body; goes with `bulk`.
        volumetric: the form of U used unless another is asked for.
        shear: initial shear modulus (Pa), for numbers as well as UFL expressions.
        about: one sentence.
        rules: restrictions that no single range expresses; returns one readable line per violation.
        isotropic: whether it is the same in all directions.
    """

    name: str
    title: str
    parameters: tuple[Parameter, ...]
    energy: Callable[[Kinematics, Constants], Expr]
    shear: Callable[[Constants], Scalar]
    bulk: Callable[[Constants], Scalar] | None = None
    compliance: Callable[[Constants], Scalar] | None = None
    volumetric: Volumetric = "log"
    about: str = ""
    rules: Callable[[Mapping[str, float]], list[str]] | None = None
    isotropic: bool = True

    def __post_init__(self) -> None:
        if (self.bulk is None) != (self.compliance is None):
            raise ValueError(f"law {self.name}: give both bulk and compliance, or neither")

    def complete(self, c: Constants) -> dict[str, Scalar]:
        """The given values, and the default of every parameter that is not given."""
        defaults = {p.name: p.default for p in self.parameters if p.default is not None}
        return {**defaults, **c}

    def psi(self, kin: Kinematics, c: Constants, volumetric: Volumetric | None = None) -> Expr:
        """Total strain energy density (Pa, per rest volume) of the displacement form.

        Args:
            kin: the deformation.
            c: value of each parameter by name: numbers, form constants or fields; those left out have their default.
            volumetric: form of U, the law's own by default.

        Raises:
            InputError: there is no such form of U.
        """
        full = self.complete(c)
        energy = self.energy(kin, full)
        if self.bulk is None:
            return energy
        return energy + self.bulk(full) * _volume_energy(kin, self._form(volumetric))

    def other_form(self, kin: Kinematics, c: Constants, own: Volumetric | None, other: str) -> Expr:
        """What another form of U stores more than a law's own, Pa, per rest volume.

        Args:
            kin: the deformation.
            c: value of each parameter by name, as in `psi`.
            own: form of U, the law's own by default.
            other: one of `other_forms`.

        Raises:
            InputError: the law has no such form.
        """
        if self.bulk is None:
            raise InputError(f"the law '{self.name}' has no separate volumetric energy")
        more = _volume_energy(kin, other) - _volume_energy(kin, self._form(own))
        return self.bulk(self.complete(c)) * more

    def other_forms(self, own: str = "") -> tuple[Volumetric, ...]:
        """The forms of U that the law may have in the displacement formulation, but for the one named ("": the law's own)."""
        return () if self.bulk is None else tuple(form for form in VOLUMETRIC if form != (own or self.volumetric))

    def psi_mixed(self, kin: Kinematics, p: Expr, c: Constants, volumetric: Volumetric | None = None) -> Expr:
        """Perturbed Lagrangian energy + p G(J) - p^2/(2 bulk), whose saddle point over p is `psi`.

        G = ln J ("log") or J - 1 ("quadratic"). It stays exact for an incompressible body, where 1/bulk is zero.

        Args:
            kin: the deformation.
            p: pressure-like unknown (Pa), positive in tension: bulk G(J) at the solution.
            c: value of each parameter by name, as in `psi`.
            volumetric: form of U, the law's own by default.

        Raises:
            InputError: the law or the form of U has no mixed formulation.
        """
        if self.compliance is None:
            raise InputError(self._no_mixed())
        full = self.complete(c)
        gap = _volume_gap(kin, self._form(volumetric))
        return self.energy(kin, full) + p * gap - self.compliance(full) * p**2 / 2

    def check(self, values: Mapping[str, object], mixed: bool = False) -> list[str]:
        """Everything that is wrong with parameter values, one readable line each; empty if nothing is.

        Args:
            values: numbers by parameter name, in the units of the parameters.
            mixed: whether they are for the mixed (displacement and pressure) formulation.
        """
        problems = self._wrong_names(values)
        problems += [text for p in self.parameters if p.name in values and (text := p.check(values[p.name]))]
        if not problems:
            numbers = {name: float(value) for name, value in self.complete(values).items()}
            problems = self._wrong_together(numbers, mixed)
        return [f"{self.name}: {text}" for text in problems]

    def check_volumetric(self, form: str, mixed: bool) -> str:
        """What is wrong with a form of U; "" if nothing is."""
        allowed = [one for one in VOLUMETRIC if not (mixed and one == "simo_taylor")]
        if self.bulk is None:
            return f"{self.name}: has no separate volumetric energy"
        return "" if form in allowed else f"{form!r}: {nearest(form, allowed)}"

    def scale(self, parameter: Parameter, values: Constants) -> float:
        """Size of a notable change of a constant, in its unit: of a stiffness by the shear modulus, of others as they declare."""
        full = {name: float(value) for name, value in self.complete(values).items()}
        own = abs(full[parameter.name])
        return max(own, float(self.shear(full))) / 3 if parameter.unit == "Pa" else max(own / 3, parameter.scale)

    def supported(self, parameter: Parameter, mixed: bool, value: float) -> Parameter:
        """A parameter of the law within the range that a formulation supports, and a `value` that is allowed already.

        Args:
            parameter: of this law.
            mixed: whether it is for the mixed (displacement and pressure) formulation.
            value: that the model has now.
        """
        if parameter.name != "poisson":
            return parameter
        if mixed:
            return replace(parameter, lower=min(LEAST_MIXED_POISSON, value), open_lower=False)
        return replace(parameter, upper=max(LARGEST_POISSON, value))

    def _wrong_names(self, values: Mapping[str, object]) -> list[str]:
        known = [p.name for p in self.parameters]
        problems = []
        for name in values:
            if name not in known:
                problems.append(f"unknown parameter '{name}'; {nearest(name, known)}")
        for p in self.parameters:
            if p.name not in values and p.default is None:
                problems.append(f"parameter '{p.name}' is missing: {p.about}, unit {p.unit}, {p.allowed}")
        return problems

    def _wrong_together(self, numbers: Mapping[str, float], mixed: bool) -> list[str]:
        problems = [] if self.rules is None else self.rules(numbers)
        shear = self.shear(numbers)
        if not shear > 0:
            problems.append(f"the initial shear modulus is {shear:.6g} Pa; it must be greater than 0 Pa")
        return problems or self._wrong_volume(numbers, mixed)

    def _wrong_volume(self, numbers: Mapping[str, float], mixed: bool) -> list[str]:
        if self.compliance is None:
            return [self._no_mixed()] if mixed else []
        compliance = _quotient(self.compliance, numbers)
        if not mixed and compliance == 0:
            return [
                "an incompressible body (poisson = 0.5) needs the mixed formulation: use it, or a poisson below 0.5"
            ]
        if mixed and not 0 <= compliance < math.inf:
            what = f"poisson = {numbers['poisson']:.12g}" if "poisson" in numbers else f"1/bulk = {compliance:.6g} 1/Pa"
            return [
                f"{what} leaves the mixed formulation without a positive bulk term; "
                "use a greater poisson (at most 0.5), or the displacement formulation"
            ]
        return []

    def _form(self, volumetric: Volumetric | None) -> Volumetric:
        return self.volumetric if volumetric is None else volumetric

    def _no_mixed(self) -> str:
        return (
            f"the law '{self.name}' has no separate volumetric energy: use the displacement formulation or another law"
        )


def _volume_energy(kin: Kinematics, form: str) -> Expr:
    """U/bulk of the displacement form."""
    if form == "log":
        return kin.lnJ**2 / 2
    if form == "simo_taylor":
        return (kin.J**2 - 1 - 2 * kin.lnJ) / 4
    if form == "quadratic":
        return (kin.J - 1) ** 2 / 2
    raise InputError(f"unknown volumetric energy '{form}'; allowed: log, simo_taylor, quadratic")


def _volume_gap(kin: Kinematics, form: str) -> Expr:
    """G(J) of the mixed form, with U = bulk/2 G^2."""
    if form == "log":
        return kin.lnJ
    if form == "quadratic":
        return kin.J - 1
    raise InputError(f"the volumetric energy '{form}' has no mixed formulation; allowed: log, quadratic")


def _quotient(function: Callable[[Constants], Scalar], numbers: Mapping[str, float]) -> float:
    # Python raises where the compiled form divides by zero and gets an infinity
    try:
        return float(function(numbers))
    except ZeroDivisionError:
        return math.inf
