"""The tables of a scene file, and the values in them: names, lengths, directions, numbers within bounds."""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError, Problems, nearest
from bcid.base.text_file import parse_toml, read_text
from bcid.base.units import quantities, quantity, usable

# Keys that are longer are not looked for by their parts.
_LONGEST_KEY = 300
_NAME = re.compile(r"^(?!\.{1,2}$)[^\s,;\"'\\/\x00-\x1f\x7f]{1,64}$")


class SceneTables:
    """A scene file, parsed: reads values of every kind, noting every problem on the way.

    Args:
        path: the TOML file; paths inside it are relative to it.

    Attributes:
        problems: what is wrong with the file.

    Raises:
        InputError: it cannot be read, or is not TOML.
    """

    def __init__(self, path: Path) -> None:
        text = read_text(path, "no such scene file; examples are in examples/scenes")
        self._table = parse_toml(text, path)
        self.path = path
        self.lines = text.splitlines()
        self.problems = Problems(f"scene {path}")

    @cached_property
    def headers(self) -> dict[str, int]:
        """First line, from 0, of each table."""
        found: dict[str, int] = {}
        for number, line in enumerate(self.lines):
            if line.lstrip().startswith("["):
                found.setdefault(line.lstrip(" \t[").partition("]")[0].strip(' \t"'), number)
        return found

    @cached_property
    def keys(self) -> dict[str, list[int]]:
        """Lines, from 0, that begin with each key."""
        found: dict[str, list[int]] = {}
        for number, line in enumerate(self.lines):
            name, equals, _ = line.partition("=")
            if equals:
                found.setdefault(name.strip().strip("\"'"), []).append(number)
        return found

    def line_of(self, key: str) -> int | None:
        """Line of the last part of a dotted key, as near as a text search gets."""
        while key:
            section, _, last = key.rpartition(".")
            start = self.headers.get(section, 0)
            lines = self.keys.get(last, [])
            place = bisect_left(lines, start)
            if place < len(lines):
                return lines[place] + 1
            if start:
                return start + 1
            # What stands in an inline table is found by the line of the table.
            key = section if len(section) < _LONGEST_KEY else ""
        return None

    def bad(self, key: str, text: str) -> None:
        line = None if self.problems.counted else self.line_of(key)
        self.problems.add(self.path, f"{key}: {text}", line)

    def table(self, parent: Mapping[str, Any], key: str, where: str = "") -> dict[str, Any]:
        value = parent.get(key, {})
        if isinstance(value, dict):
            return value
        self.bad(where + key, f"expected a table, found {value!r}")
        return {}

    def unknown(self, table: Mapping[str, Any], allowed: tuple[str, ...], where: str = "") -> None:
        for key in table:
            if key not in allowed:
                self.bad(where + key, "" if self.problems.counted else f"unknown key; {nearest(key, allowed)}")

    def text(self, table: Mapping[str, Any], key: str, default: str | None = None, where: str = "") -> str:
        value = table.get(key, default)
        if value is None:
            self.bad(where + key, "is missing")
        elif not isinstance(value, str) or (not value and default != ""):
            self.bad(where + key, f"expected text, found {value!r}")
        else:
            return value
        return ""

    def vector(self, value: object, key: str) -> tuple[float, float, float]:
        try:
            x, y, z = quantities(value, "m", 3)
            return x, y, z
        except InputError as error:
            self.bad(key, str(error))
        return 0.0, 0.0, 0.0

    def length(self, value: object, key: str) -> float:
        """A positive length in m."""
        try:
            result = quantity(value, "m")
        except InputError as error:
            self.bad(key, str(error))
            return 1.0
        if result <= 0:
            self.bad(key, f"'{value}' must be positive, as \"5 mm\"")
            return 1.0
        return result

    def direction(self, value: object, key: str) -> tuple[float, float, float]:
        numbers = isinstance(value, list) and all(
            isinstance(v, int | float) and not isinstance(v, bool) and usable(v) for v in value
        )
        if not numbers or len(value) != 3 or not any(value):  # type: ignore[arg-type]
            self.bad(key, f"expected three numbers, not all zero and none beyond 1e30, as [0, -1, 0]; found {value!r}")
            return 0.0, -1.0, 0.0
        x, y, z = np.asarray(value, float) / np.linalg.norm(np.asarray(value, float))
        return float(x), float(y), float(z)

    def names(self, table: Mapping[str, Any], what: str) -> list[str]:
        for name in table:
            if not _NAME.match(name):
                rule = "have 1 to 64 characters without spaces, commas, slashes or quotes, and not be . or .."
                self.bad(what, f"name {name!r} must {rule}")
        return list(table)

    def positive(self, table: Mapping[str, Any], key: str, unit: str, zero: bool = False) -> float | None:
        """A positive number with a unit, or without where `unit` is ""; None where it is not given.

        Where `zero` is allowed it needs no unit.
        """
        value = table.get(key.rpartition(".")[2])
        if value is None:
            return None
        bare = zero and value == 0 and not isinstance(value, bool)
        try:
            if unit and not bare:
                number = quantity(value, unit)
            elif isinstance(value, int | float) and not isinstance(value, bool):
                number = float(value)
            else:
                raise InputError(f"expected a number, found {value!r}")
        except InputError as error:
            self.bad(key, str(error))
            return None
        if not (usable(number) and (number > 0 or (zero and number == 0))):
            self.bad(key, f"{value!r} must be {'zero or ' if zero else ''}positive, and not beyond 1e30")
            return None
        return number

    def values(self, table: Mapping[str, Any], where: str) -> None:
        """Numbers and texts with a unit, whatever they are of."""
        for key, value in table.items():
            if isinstance(value, bool) or not isinstance(value, str | int | float | list):
                self.bad(where + key, f"expected a number or text with a unit, found {value!r}")
            elif isinstance(value, float) and not math.isfinite(value):
                self.bad(where + key, f"{value!r} is not a finite number")
            elif isinstance(value, float) and not usable(value):
                self.bad(where + key, f"{value!r} is too large or too small; expected a number from 1e-30 to 1e30")

    def count(self, table: Mapping[str, Any], key: str, default: int, least: int, most: int) -> int:
        """A whole number within bounds."""
        value = table.get(key.rpartition(".")[2], default)
        if type(value) is int and least <= value <= most:
            return value
        self.bad(key, f"expected a whole number from {least} to {most}, found {value!r}")
        return default
