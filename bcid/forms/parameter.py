"""A named number of the model: its unit, its meaning and the values it may take."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real


@dataclass(frozen=True)
class Parameter:
    """One number of a material law or an effect; `Amount` and `Shape` say more of it.

    Args:
        name: word used in scene files, tables and JSON.
        unit: unit of every value below, SI inside: "Pa", "1" (a pure number), "deg", "N/m^3".
        about: physical meaning in one phrase.
        default: value used when none is given; None if the user must give one.
        lower, upper: bounds of the allowed range.
        open_lower, open_upper: whether the bound itself is excluded.
        scale: size of a notable change, in the unit: step of differences and scale of fits; where only the reciprocal can
            be without influence, a value that is notable.
        prior: mean and standard deviation believed before any measurement, None if nothing is.

    Raises:
        ValueError: the bounds are reversed, or the default or neutral value lies outside them.
    """

    name: str
    unit: str
    about: str
    default: float | None = None
    lower: float = -math.inf
    upper: float = math.inf
    open_lower: bool = False
    open_upper: bool = False
    scale: float = 1.0
    prior: tuple[float, float] | None = None

    # What a parameter of a kind is not.

    @property
    def neutral(self) -> float | None:
        return None

    @property
    def law(self) -> str:
        return ""

    @property
    def scan(self) -> tuple[float, ...]:
        return ()

    @property
    def period(self) -> float | None:
        return None

    @property
    def harmonics(self) -> int | None:
        return None

    @property
    def onset(self) -> bool:
        return False

    @property
    def off(self) -> float | None:
        return None

    @property
    def within(self) -> str:
        return ""

    @property
    def switch(self) -> bool:
        return False

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ValueError(f"parameter {self.name}: lower bound {self.lower} is not below upper bound {self.upper}")
        for value in (self.default, None if self.reciprocal else self.neutral, *self.scan):
            problem = None if value is None else self.check(value)
            if problem is not None:
                raise ValueError(f"default or neutral value: {problem}")

    @property
    def reciprocal(self) -> bool:
        """Whether 1/value is what the effect is proportional to."""
        return self.neutral is not None and math.isinf(self.neutral)

    @property
    def allowed(self) -> str:
        """The allowed range in words, such as "greater than 0 Pa"."""
        bounds = []
        if math.isfinite(self.lower):
            bounds.append(f"{'greater than' if self.open_lower else 'at least'} {self._number(self.lower)}")
        if math.isfinite(self.upper):
            bounds.append(f"{'less than' if self.open_upper else 'at most'} {self._number(self.upper)}")
        return " and ".join(bounds) or "any finite number"

    def check(self, value: object) -> str | None:
        """Say what is wrong with a value, in one readable line; None if it is allowed."""
        if isinstance(value, bool) or not isinstance(value, Real):
            return f"{self.name} = {value!r} is not a number; allowed: {self.allowed}"
        number = float(value)
        if self.reciprocal and number == math.inf:
            return None
        if not math.isfinite(number):
            return f"{self.name} = {number} is not a finite number; allowed: {self.allowed}"
        if self._is_below(number) or self._is_above(number):
            return f"{self.name} = {self._number(number)} is outside the allowed range: {self.allowed}"
        return None

    def _is_below(self, number: float) -> bool:
        return number <= self.lower if self.open_lower else number < self.lower

    def _is_above(self, number: float) -> bool:
        return number >= self.upper if self.open_upper else number > self.upper

    def _number(self, number: float) -> str:
        # 12 digits hide the binary tail of 1/3, but a value refused for its last digit must still show it
        short = f"{number:.12g}"
        text = short if float(short) == number or number in (self.lower, self.upper) else repr(number)
        return text if self.unit == "1" else f"{text} {self.unit}"


@dataclass(frozen=True)
class Amount(Parameter):
    """A number that says how much there is of something.

    Args:
        neutral: value at which it has no influence; infinite where only the reciprocal can be without influence (the
            stiffness of a spring that replaces a rigid hold).
        law: the neutral value is that of this constant of the material law (`neutral` then only stands for it).
        switch: it is neutral or one scale from that, and nothing between: no fit moves it.
        scan: large values at which it is tried where small ones show nothing, for what they do is far from linear.
    """

    neutral: float = 0.0
    law: str = ""
    switch: bool = False
    scan: tuple[float, ...] = ()


@dataclass(frozen=True)
class Shape(Parameter):
    """A number that says where, in which direction or how fast something acts.

    Args:
        scan: values at which it is tried before a fit.
        period: it repeats itself with this period (an angle).
        harmonics: highest harmonic in that period of what the effect does, if it is a trigonometric polynomial.
        onset: it is the number of the first frame in which the effect acts: every frame is tried, and no fit moves it.
        off: value that stands for none (a period of 0 for what is steady): a fit leaves it alone.
        within: it is a place that lies in the body, along "x", "y" or "z"; or, for "size", no more than half its diagonal. A fit
            keeps to that.
    """

    scan: tuple[float, ...] = ()
    period: float | None = None
    harmonics: int | None = None
    onset: bool = False
    off: float | None = None
    within: str = ""
