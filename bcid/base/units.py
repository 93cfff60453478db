"""Units at the border: text such as ``"15 kPa"`` or ``"15 10 12.5 mm"`` becomes SI numbers, and back.

Inside bcid everything is SI (m, s, N, Pa, kg) and angles are degrees.
"""

from __future__ import annotations

import math
import re
from typing import Any

from bcid.base.errors import InputError

# Each unit: factor to SI and exponents of (metre, kilogram, second, degree).
_NEWTON = (1, 1, -2, 0)
_PASCAL = (-1, 1, -2, 0)
_UNITS: dict[str, tuple[float, tuple[int, int, int, int]]] = {
    "1": (1.0, (0, 0, 0, 0)),
    "%": (0.01, (0, 0, 0, 0)),
    "m": (1.0, (1, 0, 0, 0)),
    "cm": (1e-2, (1, 0, 0, 0)),
    "mm": (1e-3, (1, 0, 0, 0)),
    "um": (1e-6, (1, 0, 0, 0)),
    "µm": (1e-6, (1, 0, 0, 0)),
    "in": (0.0254, (1, 0, 0, 0)),
    "kg": (1.0, (0, 1, 0, 0)),
    "g": (1e-3, (0, 1, 0, 0)),
    "s": (1.0, (0, 0, 1, 0)),
    "ms": (1e-3, (0, 0, 1, 0)),
    "min": (60.0, (0, 0, 1, 0)),
    "N": (1.0, _NEWTON),
    "mN": (1e-3, _NEWTON),
    "kN": (1e3, _NEWTON),
    "Pa": (1.0, _PASCAL),
    "kPa": (1e3, _PASCAL),
    "MPa": (1e6, _PASCAL),
    "GPa": (1e9, _PASCAL),
    "deg": (1.0, (0, 0, 0, 1)),
    "rad": (180.0 / math.pi, (0, 0, 0, 1)),
}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_QUANTITY = re.compile(rf"^\s*((?:{_NUMBER}[\s,]+)*{_NUMBER})\s*([^\d\s.,+-].*)?$")
_FACTOR = re.compile(r"^([A-Za-zµ%1]+)(?:\^(-?\d))?$")
# Quantities and units that are longer are none.
_LONGEST = 1000
_LONGEST_UNIT = 64
# Magnitudes that can be squared, cubed and divided by without leaving the range of a double, and the largest length, m.
LEAST, MOST = 1e-30, 1e30
FURTHEST = 1e6
# Smallest standard deviation that is accepted, SI: that of a length is a millionth of an atom.
LEAST_SIGMA = 1e-15
_METRE = (1, 0, 0, 0)

Dimension = tuple[int, int, int, int]


def parse_unit(text: str) -> tuple[float, Dimension]:
    """Factor to SI and dimension exponents (metre, kilogram, second, degree) of a unit such as ``"N/m^3"``.

    Raises `InputError` for a unit that is not known.
    """
    if len(text) > _LONGEST_UNIT:
        raise InputError(f"unit '{text}' is not known; units are products of {', '.join(_UNITS)}")
    factor, exponents = 1.0, [0, 0, 0, 0]
    for position, part in enumerate(re.split(r"([*/])", text.replace(" ", "").replace("²", "^2").replace("³", "^3"))):
        if position % 2:
            continue
        sign = -1 if position and _operator_before(text, position) == "/" else 1
        match = _FACTOR.match(part)
        if not match or match.group(1) not in _UNITS:
            raise InputError(f"unit '{text}' is not known; units are products of {', '.join(_UNITS)}")
        power = sign * int(match.group(2) or 1)
        unit_factor, unit_exponents = _UNITS[match.group(1)]
        factor *= unit_factor**power
        exponents = [e + power * u for e, u in zip(exponents, unit_exponents, strict=True)]
    return factor, (exponents[0], exponents[1], exponents[2], exponents[3])


def _operator_before(text: str, position: int) -> str:
    return re.split(r"([*/])", text.replace(" ", ""))[position - 1]


def unit_factor(unit: str, like: str) -> float:
    """SI value of one `unit`, which must have the dimension of `like` (``unit_factor("mm", like="m") == 1e-3``)."""
    factor, dimension = parse_unit(unit)
    if dimension != parse_unit(like)[1]:
        raise InputError(f"unit '{unit}' cannot be used here: expected a unit like '{like}'")
    return factor


def quantities(text: object, like: str, count: int) -> list[float]:
    """`count` numbers and one unit, as in ``"15 10 12.5 mm"``, in SI.

    Args:
        text: the value as written; anything but a string is refused, for a bare number has no unit.
        like: a unit of the wanted dimension, as ``"m"``.
        count: how many numbers must stand before the unit.

    Raises:
        InputError: names the value, the rule and an example.
    """
    example = f'"{" ".join(["1"] * count)} {"mm" if like == "m" else like}"'
    if not isinstance(text, str):
        raise InputError(f"{text!r} has no unit: write text with a number and a unit, as {example}")
    match = _QUANTITY.match(text) if len(text) <= _LONGEST else None
    if not match:
        raise InputError(f"'{text}' is not a quantity: write {count} number(s) and a unit, as {example}")
    numbers = [float(word) for word in re.split(r"[\s,]+", match.group(1).strip())]
    if not match.group(2):
        raise InputError(f"'{text}' has no unit: write a unit like '{like}' behind it, as {example}")
    if len(numbers) != count:
        raise InputError(f"'{text}' has {len(numbers)} number(s), expected {count}, as {example}")
    factor = unit_factor(match.group(2).strip(), like)
    values = [number * factor for number in numbers]
    if not all(math.isfinite(value) for value in values):
        raise InputError(f"'{text}' is not finite")
    most = FURTHEST if parse_unit(like)[1] == _METRE else MOST
    if not all(usable(value, most) for value in values):
        raise InputError(f"'{text}' is too large or too small: expected a magnitude from 1e-30 to {most:g} {like}")
    return values


def usable(value: float, most: float = MOST) -> bool:
    """Whether a number is zero, or of a magnitude that can be computed with."""
    return value == 0 or LEAST <= abs(value) <= most


def measurable(sigma: float) -> bool:
    """Whether a standard deviation (SI) is one that an instrument may have: its square must be a number to divide by."""
    return LEAST_SIGMA <= sigma <= MOST


def quantity(text: object, like: str) -> float:
    """One number with its unit, as ``"15 kPa"``, in SI; see `quantities`."""
    return quantities(text, like, 1)[0]


def show(value: float, unit: str, digits: int = 3) -> str:
    """An SI value in `unit`, for a message: ``show(15e3, "kPa") == "15 kPa"``."""
    return f"{value / parse_unit(unit)[0]:.{digits}g} {unit}"


def significance(p: float) -> str:
    """A p-value for people: "0.58", "< 0.0001"; "" where there is none."""
    if not math.isfinite(p):
        return ""
    return "< 0.0001" if p < 0.0001 else f"{p:.2g}"


def p_value(p: float) -> str:
    """The same in a sentence: "p = 0.58", "p < 0.0001"."""
    shown = significance(p)
    return f"p {shown}" if shown.startswith("<") else f"p = {shown or 'not known'}"


def for_people(value: float, error: float | None, unit: str) -> tuple[float, float | None, str]:
    """A number, its standard error and their unit as they are shown: lengths in mm."""
    if unit != "m":
        return value, error, unit
    return 1e3 * value, None if error is None else 1e3 * error, "mm"


def force_unit(largest: float) -> tuple[float, str]:
    """How many of the unit in which forces are shown make a newton, and the unit: mN, or N where the largest (N) is one or more."""
    return (1.0, "N") if largest >= 1.0 else (1e3, "mN")


# Half the width of an interval that holds a Gaussian value with 95 %, in standard deviations.
WIDE = 1.959964


def percent(probability: float) -> str:
    """A probability for people: whole, with digits only near certainty, and never 100 % or 0 % when it is not."""
    if probability >= 0.9999:
        return "> 99.99 %"
    if probability <= 0.0001:
        return "< 0.01 %"
    probability = float(probability)
    rarer = min(probability, 1 - probability)
    return f"{100 * probability:.{(rarer < 0.01) + (rarer < 0.001)}f} %"


# The standard error of a number of which the data tell nothing is larger.
UNTOLD = 1e50


# Where what an error loses, as a mean square, is less than that of this part of the noise, it hardly falls.
_HARDLY = 0.5


def hardly_falls(before: float, after: float, noise: float) -> bool:
    """Whether an error (RMS) falls by so little that noise could hide it; all in the same unit."""
    return before**2 - after**2 < (_HARDLY * noise) ** 2


def falls(before: float, after: float, noise: float, unit: str) -> str:
    """How an error (RMS) changes: "falls from 1.42 to 0.205 mm"; all in the same unit."""
    return (
        f"{'hardly falls,' if hardly_falls(before, after, noise) else 'falls'} from {before:.3g} to {after:.3g} {unit}"
    )


def uncertain(value: float, error: float | None = None, unit: str = "1") -> str:
    """A value with its standard error, to as many digits as that has meaning, two of the error: "1257.6 ± 9.4 mm"."""
    after = "" if unit == "1" else f" {unit}"
    if not math.isfinite(value):
        return "infinite" + after
    if error is None or not math.isfinite(error) or error <= 0:
        return f"{value:.4g}{after}".replace("-", "−")
    if error > UNTOLD:
        return "cannot be told"
    places = 1 - math.floor(math.log10(error))
    if places > 6 or abs(value) >= 1e7:
        return f"{value:.4g} ± {error:.2g}{after}".replace("-", "−")
    shown, beside = (f"{round(number, places):.{max(0, places)}f}" for number in (value, error))
    return f"{shown} ± {beside}{after}".replace("-", "−")


def limited(value: float, limit: float, unit: str) -> str:
    """A number that ended at a bound, by what it is on this side of with 95 %: "at most 120 Pa (95 %)"."""
    shown, _, unit = for_people(limit, None, unit)
    after = "" if unit == "1" else f" {unit}"
    return f"at {'most' if limit > value else 'least'} {shown:.3g}{after} (95 %)".replace("-", "−")


# Units of the arrays that bcid writes, by name of the variable.
_METRES = ("position", "measured", "predicted", "predicted_first", "rest", "sigma", "mesh_error", "layout_residual")
_ARRAYS = dict.fromkeys((*_METRES, "points", "displacement", "translation"), "m") | {
    "time": "s",
    "rotation": "1",
    "load": "N",
    "wrench": "N (fx fy fz), N m (tx ty tz)",
    "covariance": "m^2",
    "pixel": "px",
    "misfit": "1",
    "energy": "J/m^3",
}


def with_units(data: Any) -> Any:
    """A copy of an xarray dataset whose variables carry their unit as the attribute `units`, as the CF conventions have it.

    What an effect contributes to positions is called part_0, part_1 and so on.
    """
    data = data.copy()
    for name in map(str, data.variables):
        unit = "m" if name.startswith("part_") else _ARRAYS.get(name)
        if unit is not None:
            data[name].attrs["units"] = unit
    return data
