"""Families of strain energies: powers and exponentials of the invariants, with or without a direction or a gradient.

Invariants and their polyconvexity: Ball, Arch. Ration. Mech. Anal. 63 (1977) 337; Hartmann & Neff, Int. J. Solids Struct. 40
(2003) 2767 for the isochoric ones; Schroeder & Neff, Int. J. Solids Struct. 40 (2003) 401 for fibres.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bcid.forms.parameter import Amount, Shape
from bcid.grammar.deformed import Deformed
from bcid.grammar.family import Family, Values
from bcid.grammar.replaced_law import APART, ReplacedLaw

Array = NDArray[np.float64]
Slopes = Callable[[Deformed, Values], tuple[Array | float, Array | float, Array | float]]

_POSITIVE = "polyconvex as the coefficient is not negative"
UNKNOWN = "not known to be polyconvex"
# Rates of an exponential and exponents that are tried. A steep exponential seems to do far more in a body that is soft without it
# than it will once it holds back: from the mildest a fit gets to the others.
_RATES, _POWERS = (0.3, 3.0, 12.0), (0.25, 0.5, 2.0)
# Directions that are tried: elevations out of the plane of fibres, with azimuths about so far apart, degrees.
_APART = 22.5
RATE = Shape("rate", "1", "how fast it grows", default=3.0, lower=0.0, open_lower=True, upper=200.0, scale=2.0)

TURNED = (
    Shape("azimuth", "deg", "of the direction, in the plane of fibres", 0.0, -360.0, 720.0, scale=20.0, period=360.0),
    Shape("elevation", "deg", "of the direction, out of that plane", 0.0, -180.0, 180.0, scale=20.0, period=180.0),
)
# The direction, a, as code.
AXIS = (
    "plane = point.kin.direction(c['azimuth'])",
    "across = ufl.cross(*map(ufl.as_vector, point.kin.axes))",
    "tilt = c['elevation'] * (math.pi / 180)",
    "a = ufl.cos(tilt) * plane + ufl.sin(tilt) * across",
)


def energies(shear: float, law: ReplacedLaw = APART) -> list[Family]:
    """All families, for a body of this shear modulus, Pa; of `law` what acts in its place takes away."""
    return [*_isotropic(shear), _second_for_first(shear, law), *_graded(shear), *_directed(shear)]


def coefficient(scale: float, lower: float = 0.0, name: str = "c") -> Amount:
    return Amount(name, "Pa", "coefficient", lower=lower, neutral=0.0, scale=scale)


def _stress(slopes: Slopes) -> Callable[[Deformed, Values], Array]:
    """First Piola stress of an energy of the invariants, per unit of its coefficient."""

    def unit(d: Deformed, values: Values) -> Array:
        first, second, volume = slopes(d, values)
        parts = [(first, d.first_slope), (second, d.second_slope), (volume, d.volume_slope)]
        found = np.zeros_like(d.F)
        for factor, slope in parts:
            if np.any(factor):
                found += np.broadcast_to(factor, d.J.shape)[:, None, None] * slope
        return found[..., None]

    return unit


def _isotropic(shear: float) -> list[Family]:
    power = Shape("power", "1", "exponent", default=0.5, lower=0.0, open_lower=True, upper=8.0, scale=0.3)

    def family(
        name: str,
        about: str,
        formula: str,
        code: str,
        scale: float,
        slopes: Slopes,
        lower: float = 0.0,
        shapes: tuple[Shape, ...] = (),
        scans: tuple[dict[str, float], ...] = ({},),
        convex: str = _POSITIVE,
    ) -> Family:
        amounts = (coefficient(scale * shear, lower),)
        return Family(
            name, "energy", about, formula, code, amounts, shapes, _stress(slopes), scans=scans, polyconvex=convex,
            instead_of="law",
        )  # fmt: skip

    a, b = "point.kin.I1bar_minus_3", "point.kin.I2bar_minus_3"
    return [
        family(
            "second_invariant", "the energy depends on the second invariant, as in Mooney and Rivlin's law",
            "c (I2bar - 3)", f"return c['c'] * {b}", 0.2, lambda d, v: (0.0, 1.0, 0.0),
            convex="polyconvex with the exponent 3/2 only; the law itself keeps it stable",
        ),
        family(
            "first_squared", "the body gets stiffer the more it is stretched", "c (I1bar - 3)^2",
            f"return c['c'] * {a} ** 2", 1.0, lambda d, v: (2 * d.first, 0.0, 0.0), -0.2 * shear,
        ),
        family(
            "second_squared", "the body gets stiffer with the square of the second invariant", "c (I2bar - 3)^2",
            f"return c['c'] * {b} ** 2", 1.0, lambda d, v: (0.0, 2 * d.second, 0.0), -0.2 * shear,
        ),
        family(
            "both_invariants", "the invariants act together", "c (I1bar - 3) (I2bar - 3)",
            f"return c['c'] * {a} * {b}", 1.0, lambda d, v: (d.second, d.first, 0.0), convex=UNKNOWN,
        ),
        family(
            "first_cubed", "the body gets stiffer late", "c (I1bar - 3)^3",
            f"return c['c'] * {a} ** 3", 3.0, lambda d, v: (3 * d.first**2, 0.0, 0.0),
        ),
        family(
            "exponential", "the body gets stiffer exponentially", "c (exp(rate (I1bar - 3)) - 1 - rate (I1bar - 3)) / rate^2",
            f"x = c['rate'] * {a}\nreturn c['c'] * (ufl.exp(x) - 1 - x) / c['rate'] ** 2", 1.0,
            lambda d, v: (np.expm1(np.minimum(v["rate"] * d.first, 50.0)) / v["rate"], 0.0, 0.0),
            shapes=(RATE,), scans=tuple({"rate": r} for r in _RATES),
        ),
        family(
            "logarithm", "the energy grows with the logarithm of the second invariant", "c ln(I2bar / 3)",
            f"return c['c'] * ufl.ln(1 + {b} / 3)", 1.0, lambda d, v: (0.0, 1 / (3 + d.second), 0.0), convex=UNKNOWN,
        ),
        family(
            "power", "the energy is a power of the first invariant", "c ((I1bar / 3)^power - 1)",
            f"return c['c'] * ((1 + {a} / 3) ** c['power'] - 1)", 1.0,
            lambda d, v: (v["power"] / 3 * (1 + d.first / 3) ** (v["power"] - 1), 0.0, 0.0),
            shapes=(power,), scans=tuple({"power": p} for p in _POWERS), convex="polyconvex from the exponent 1 on",
        ),
        family(
            "volume", "the body resists a change of volume more", "c (J - 1)^2",
            "return c['c'] * (point.kin.J - 1) ** 2", 1.0, lambda d, v: (0.0, 0.0, 2 * (d.J - 1)),
        ),
    ]  # fmt: skip


def _second_for_first(shear: float, law: ReplacedLaw) -> Family:
    def unit(d: Deformed, values: Values) -> Array:
        return np.asarray((d.second_slope - 2 * law.slope(d))[..., None])

    return Family(
        "second_for_first", "energy", "the energy depends on the second invariant in the place of the first",
        f"c (I2bar - 3 - 2 {law.text})", f"return c['c'] * (point.kin.I2bar_minus_3 - 2 * {law.code})",
        (coefficient(0.2 * shear),), (), unit, polyconvex=UNKNOWN, instead_of="law",
    )  # fmt: skip


def _graded(shear: float) -> list[Family]:
    """Energies whose coefficient changes linearly over the body."""
    found = []
    pairs = (
        ("second_invariant", "I2bar - 3", "I2bar_minus_3", 0.2, lambda d: d.second_slope),
        (
            "first_squared",
            "(I1bar - 3)^2",
            "I1bar_minus_3 ** 2",
            1.0,
            lambda d: 2 * d.first[:, None, None] * d.first_slope,
        ),
    )
    for name, text, code, scale, slope in pairs:

        def unit(d: Deformed, values: Values, slope: Callable[[Deformed], Array] = slope) -> Array:
            along = (d.points.places - d.centre) / d.size
            return np.asarray(slope(d)[..., None] * along[:, None, None, :])

        amounts = tuple(
            Amount(
                f"g{axis}",
                "Pa",
                f"change of the coefficient over the body along {axis}",
                neutral=0.0,
                scale=scale * shear,
            )
            for axis in "xyz"
        )
        lines = (
            "across = (point.X - point.centre) / point.size",
            "factor = ufl.inner(ufl.as_vector([c['gx'], c['gy'], c['gz']]), across)",
            f"return factor * point.kin.{code}",
        )
        found.append(
            Family(
                f"{name}_graded",
                "energy",
                "a term of the energy differs over the body",
                f"g . (X - centre)/size {text}",
                "\n".join(lines),
                amounts,
                (),
                unit,
                polyconvex=UNKNOWN,
            )
        )
    return found


def directions() -> list[dict[str, float]]:
    """About evenly spread directions of half of the sphere."""
    found = []
    for elevation in np.arange(0.0, 90.1, _APART):
        count = max(1, round(float(np.cos(np.radians(elevation))) * (180 if elevation == 0 else 360) / _APART))
        around = 180 if elevation == 0 else 360
        found += [{"azimuth": float(k * around / count), "elevation": float(elevation)} for k in range(count)]
    return found


def _directed(shear: float) -> list[Family]:
    """Energies of the stretch along a direction, or of the shear across it."""

    def family(
        name: str,
        about: str,
        formula: str,
        last: str,
        scale: float,
        factor: Callable[[Array, Values], Array],
        lower: float = 0.0,
        rates: bool = False,
        convex: str = _POSITIVE,
    ) -> Family:
        def unit(d: Deformed, values: Values) -> Array:
            direction = d.direction(values["azimuth"], values["elevation"])
            stretched = d.F @ direction
            x = np.einsum("qi,qi->q", stretched, stretched) - 1
            return np.asarray(2 * factor(x, values)[:, None, None] * stretched[:, :, None] * direction)[..., None]

        tried = [{"rate": r} for r in _RATES] if rates else [{}]
        scans = tuple(where | r for where, r in itertools.product(directions(), tried))
        code = "\n".join([*AXIS, "x = point.kin.invariant4_minus_1(a)", f"return {last}"])
        shapes = (*TURNED, RATE) if rates else TURNED
        amounts = (coefficient(scale * shear, lower),)
        text = f"{formula} with I4 = a . C a, a the direction"
        return Family(name, "energy", about, text, code, amounts, shapes, unit, scans=scans, polyconvex=convex)

    def tension(x: Array) -> Array:
        return np.maximum(x, 0.0)

    return [
        _crossed(shear, TURNED[0]),
        _transverse(shear),
        family("fibre", "fibres make the body stiffer along a direction in space", "c/2 (I4 - 1)^2",
               "c['c'] / 2 * x**2", 0.4, lambda x, v: x, convex=UNKNOWN),
        family("fibre_in_tension", "fibres resist being stretched, and do not resist being pressed", "c/2 max(I4 - 1, 0)^2",
               "c['c'] / 2 * ufl.max_value(x, 0.0) ** 2", 0.4, lambda x, v: tension(x)),
        family("fibre_exponential", "fibres get stiffer exponentially", "c/(2 rate) (exp(rate (I4 - 1)^2) - 1)",
               "c['c'] / (2 * c['rate']) * (ufl.exp(c['rate'] * x**2) - 1)", 0.4,
               lambda x, v: x * np.exp(np.minimum(v["rate"] * x**2, 50.0)), rates=True, convex=UNKNOWN),
        family("fibre_stress", "the body pulls itself together along a direction in space", "c/2 (I4 - 1)",
               "c['c'] / 2 * x", 0.1, lambda x, v: np.full_like(x, 0.5), lower=-np.inf, convex=""),
    ]  # fmt: skip


def _transverse(shear: float) -> Family:
    """One direction in which stretch and shear are resisted otherwise (Spencer, in: Continuum Theory of the Mechanics of
    Fibre-Reinforced Composites, 1984): at small strain c_shear adds to the shear modulus in planes that hold the direction."""

    def unit(d: Deformed, values: Values) -> Array:
        a = d.direction(values["azimuth"], values["elevation"])
        stretched, pulled = d.F @ a, d.C @ a
        square = np.einsum("qi,qi->q", stretched, stretched)[:, None, None]
        along = stretched[:, :, None] * a
        across = stretched[:, :, None] * pulled[:, None, :] + (d.F @ pulled[..., None]) * a - 2 * square * along
        return np.stack([2 * (square - 1) * along, across], axis=-1)

    code = (*AXIS, "square = point.kin.invariant4(a)", "sheared = point.kin.invariant5(a) - square**2",
            "return c['c_stretch'] / 2 * (square - 1) ** 2 + c['c_shear'] / 2 * sheared")  # fmt: skip
    amounts = (
        coefficient(0.4 * shear, -0.4 * shear, "c_stretch"),
        # Beyond minus the shear modulus the body would shear by itself.
        coefficient(0.2 * shear, -0.9 * shear, "c_shear"),
    )
    return Family(
        "transverse", "energy", "the body resists stretch and shear along one direction otherwise than along others",
        "c_stretch/2 (I4 - 1)^2 + c_shear/2 (I5 - I4^2) with I4 = a . C a, I5 = a . C^2 a, a the direction", "\n".join(code),
        amounts, TURNED, unit, scans=tuple(directions()), polyconvex=UNKNOWN,
    )  # fmt: skip


def _crossed(shear: float, azimuth: Shape) -> Family:
    """Two families of fibres that cross in the plane of fibres (Holzapfel, Gasser & Ogden, J. Elasticity 61 (2000) 1)."""
    half = Shape(
        "half_angle",
        "deg",
        "of each family to the direction between them",
        default=30.0,
        lower=0.0,
        upper=90.0,
        scale=10.0,
    )

    def unit(d: Deformed, values: Values) -> Array:
        found = np.zeros_like(d.F)
        for side in (1.0, -1.0):
            direction = d.direction(values["azimuth"] + side * values["half_angle"], 0.0)
            stretched = d.F @ direction
            x = np.maximum(np.einsum("qi,qi->q", stretched, stretched) - 1, 0.0)
            factor = 2 * x * np.exp(np.minimum(values["rate"] * x**2, 50.0))
            found += factor[:, None, None] * stretched[:, :, None] * direction
        return found[..., None]

    code = (
        "rate, energy = c['rate'], 0.0",
        "for side in (1.0, -1.0):",
        "    a = point.kin.direction(c['azimuth'] + side * c['half_angle'])",
        "    x = ufl.max_value(point.kin.invariant4_minus_1(a), 0.0)",
        "    energy += (ufl.exp(rate * x**2) - 1) / (2 * rate)",
        "return c['c'] * energy",
    )
    scans = tuple(
        {"azimuth": float(a), "half_angle": h, "rate": r}
        for a in np.arange(0.0, 180.0, _APART)
        for h in (15.0, 30.0, 45.0)
        for r in _RATES
    )
    return Family(
        "crossed_fibres", "energy", "two families of fibres that cross get stiffer exponentially",
        "c/(2 rate) sum of exp(rate max(I4 - 1, 0)^2) - 1 over both families", "\n".join(code), (coefficient(0.4 * shear),),
        (azimuth, half, RATE), unit, scans=scans, polyconvex=_POSITIVE,
    )  # fmt: skip
