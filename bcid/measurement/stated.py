"""What a TOML file states, checked: whatever is wrong is noted, and something harmless is given back in its place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bcid.base.errors import InputError, Problems
from bcid.base.units import LEAST_SIGMA, measurable, unit_factor, usable
from bcid.measurement.contents import SIGMAS, Sigma, Units
from bcid.scene.uncertainty import MOST_SCALE

UNITS = {"length_unit": "m", "time_unit": "s", "force_unit": "N"}
SCALE_KEYS = ("scale_sigma", "scale_of_gripper")


def is_number(value: object) -> bool:
    """Whether it is a number whose square is one; truth values are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and usable(value)


def are_texts(value: object, count: int, partial: bool = False) -> bool:
    """Whether it is a list of so many names, some of which may be empty where it may be partial."""
    if not (isinstance(value, list) and len(value) == count and all(isinstance(v, str) for v in value)):
        return False
    return any(value) if partial else all(value)


@dataclass(frozen=True)
class Stated:
    """Checks values of a file; `prefix` stands before their keys in messages, as the name of their table."""

    path: Path
    problems: Problems
    prefix: str = ""

    def bad(self, key: str, text: str) -> None:
        """Note what is wrong with a key."""
        self.problems.add(self.path, f"{self.prefix}{key}: {text}")

    def expect(self, fine: bool, key: str, what: str, found: object) -> bool:
        """Note that a value is not what is expected, if so; returns whether it is fine."""
        if not fine:
            self.bad(key, f"expected {what}, found {found!r}")
        return fine

    def only(self, table: Iterable[str], allowed: Iterable[str]) -> None:
        """Note every key that is not allowed."""
        self.problems.add_unknown(self.path, table, allowed, f"{self.prefix}{{}}: unknown key; {{}}".format)

    def table(self, table: Mapping[str, Any], key: str) -> dict[str, Any]:
        """A table within another; empty where there is none."""
        value = table.get(key, {})
        return value if self.expect(isinstance(value, dict), key, "a table", value) else {}

    def units(self, table: Mapping[str, Any]) -> tuple[Units, tuple[float, float, float]]:
        """The units of length, time and force, each of which must be there, and SI per unit of each."""
        length, time, force = (self._unit(table, key, like) for key, like in UNITS.items())
        return Units(*(str(table.get(key, like)) for key, like in UNITS.items())), (length, time, force)

    def _unit(self, table: Mapping[str, Any], key: str, like: str) -> float:
        unit = table.get(key)
        try:
            if isinstance(unit, str):
                return unit_factor(unit, like)
            found = "is missing" if unit is None else f"expected text, found {unit!r}"
            raise InputError(f'{found}; write {key} = "{"mm" if like == "m" else like}"')
        except InputError as error:
            self.bad(key, str(error))
            return 1.0

    def sigmas(self, table: Mapping[str, Any], length: float, force: float) -> tuple[Sigma, float | None, float | None]:
        """Standard deviations of positions, forces and torques, SI, from those in units of `length` m and `force` N."""
        stated = table.get(SIGMAS[0])
        noise: Sigma
        if isinstance(stated, list):
            what = "one number, or three for x, y and z"
            fine = self.expect(len(stated) == 3, SIGMAS[0], what, stated)
            noise = tuple(self._sigma(SIGMAS[0], one, length) for one in stated) if fine else None
        else:
            noise = self._sigma(SIGMAS[0], stated, length)
        wrench, torque = (table.get(key) for key in SIGMAS[1:])
        return noise, self._sigma(SIGMAS[1], wrench, force), self._sigma(SIGMAS[2], torque, force * length)

    def _sigma(self, key: str, value: Any, unit: float) -> float | None:
        if value is None:
            return None
        fine = isinstance(value, int | float) and not isinstance(value, bool) and measurable(value * unit)
        allowed = f"a positive number from {LEAST_SIGMA / unit:.3g} to 1e30 (in units of this file)"
        return float(value) * unit if self.expect(fine, key, allowed, value) else None

    def scale(self, table: Mapping[str, Any], key: str = SCALE_KEYS[0]) -> float | None:
        """A relative standard deviation of the length of a pixel."""
        value = table.get(key)
        if value is None:
            return None
        fine = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= MOST_SCALE
        what = f"a number above 0 and up to {MOST_SCALE} (0.02 is 2 %)"
        return float(value) if self.expect(fine, key, what, value) else None

    def flag(self, table: Mapping[str, Any], key: str = SCALE_KEYS[1]) -> bool:
        """Whether something is so; no, where nothing is said."""
        value = table.get(key, False)
        return self.expect(isinstance(value, bool), key, "true or false", value) and value is True
