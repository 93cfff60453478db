"""Reading a scene from TOML: validated as a whole, every problem told at once, unknown keys refused."""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError, Problems, nearest
from bcid.base.text_file import parse_toml, read_text
from bcid.base.units import quantities, quantity, unit_factor, usable
from bcid.scene.parts import Box, Grasp, Level, Limits, Material, Plane, Region, Values, Vector
from bcid.scene.uncertainty import ANGLES, FORCES, LENGTHS, Uncertainty

FORMAT = "bcid-scene/1"
DEGREES = (1, 2)
FORMULATIONS = ("displacement", "mixed")
_VALUES = ("format", "name", "description", "down", "fibre_plane", "support", "noise_sigma", "attach_within")
_TABLES = (
    "geometry",
    "levels",
    "material",
    "patches",
    "grasps",
    "fiducials",
    "places",
    "effects",
    "explore",
    "uncertainty",
)
_EXPLORE = ("displacement", "force", "strain", "amplitudes", "directions", "steps", "cost", "regrasp")
_AXES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
# Keys that are longer are not looked for by their parts.
_LONGEST_KEY = 300
_NAME = re.compile(r"^(?!\.{1,2}$)[^\s,;\"'\\/\x00-\x1f\x7f]{1,64}$")


class SceneFile:
    """A scene file, parsed; turns its tables into the fields of a `Scene`, noting every problem on the way.

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

    def fibre_plane(self, value: object) -> tuple[Vector, Vector] | None:
        """Two directions that are perpendicular to each other."""
        if not isinstance(value, list) or len(value) != 2:
            self.bad("fibre_plane", f"expected two directions, as [[1, 0, 0], [0, 0, 1]]; found {value!r}")
            return None
        first, second = (self.direction(one, "fibre_plane") for one in value)
        if abs(float(np.dot(first, second))) > 1e-6:
            self.bad("fibre_plane", f"the directions must be perpendicular to each other; found {value!r}")
        return first, second

    def names(self, table: Mapping[str, Any], what: str) -> list[str]:
        for name in table:
            if not _NAME.match(name):
                rule = "have 1 to 64 characters without spaces, commas, slashes or quotes, and not be . or .."
                self.bad(what, f"name {name!r} must {rule}")
        return list(table)

    def fields(self) -> dict[str, Any]:
        """The fields of a `Scene` by name; worthless where problems were found."""
        table = self._table
        self.unknown(table, (*_VALUES, *_TABLES))
        if table.get("format") != FORMAT:
            self.bad("format", f'expected "{FORMAT}", found {table.get("format")!r}')
        optional = {key: self.length(table[key], key) for key in ("noise_sigma", "attach_within") if key in table}
        geometry, unit, parameters = self.geometry(self.table(table, "geometry"))
        patches = self.table(table, "patches")
        grasps = self.table(table, "grasps")
        places = self.table(table, "places")
        fiducials = self.table(table, "fiducials")
        for what, entries in (("patches", patches), ("grasps", grasps), ("places", places), ("fiducials", fiducials)):
            self.names(entries, what)
        if not patches:
            self.bad("patches", "none is defined: name at least one candidate patch")
        if not fiducials:
            self.bad("fiducials", 'none is defined: write name = "x y z mm" for each marker')
        support = self.text(table, "support", "")
        if support and support not in places:
            self.bad("support", f"place '{support}' is not defined; {nearest(support, places)}")
        return {
            "name": self.text(table, "name", self.path.stem),
            "geometry": geometry,
            "parameters": parameters,
            "length_unit": unit,
            "levels": self.levels(table.get("levels"), geometry),
            "material": self.material(self.table(table, "material")),
            "patches": {name: self.region(value, f"patches.{name}", ("divide",)) for name, value in patches.items()},
            "grasps": {name: self.grasp(value, f"grasps.{name}") for name, value in grasps.items()},
            "fiducials": {name: self.vector(value, f"fiducials.{name}") for name, value in fiducials.items()},
            "places": {name: self.region(value, f"places.{name}") for name, value in places.items()},
            "divide": self.divide(patches),
            "down": self.direction(table.get("down", [0, -1, 0]), "down"),
            "fibre_plane": self.fibre_plane(table["fibre_plane"]) if "fibre_plane" in table else None,
            "support": support,
            "noise_sigma": optional.get("noise_sigma"),
            "attach_within": optional.get("attach_within"),
            "effects": {name: self.effect(value, name) for name, value in self.table(table, "effects").items()},
            "limits": self.limits(self.table(table, "explore")) if "explore" in table else None,
            "uncertainty": self.uncertainty(self.table(table, "uncertainty")),
            "description": self.text(table, "description", ""),
            "source": str(self.path),
        }

    def limits(self, table: Mapping[str, Any]) -> Limits:
        """What exploring may do to the body."""
        self.unknown(table, _EXPLORE, "explore.")
        if "displacement" not in table:
            self.bad("explore.displacement", 'is missing: write how far the gripper may go, as "8 mm"')
        furthest = self.length(table.get("displacement", "1 m"), "explore.displacement")
        written = table.get("amplitudes", [])
        if not isinstance(written, list):
            self.bad("explore.amplitudes", f'expected a list, as ["4 mm", "8 mm"], found {written!r}')
            written = []
        amplitudes = [self.length(value, "explore.amplitudes") for value in written] or [furthest, furthest / 2]
        if max(amplitudes) > furthest * (1 + 1e-9):
            self.bad("explore.amplitudes", "one of them is larger than explore.displacement")
        directions = {
            name: self.direction(value, f"explore.directions.{name}")
            for name, value in (
                self.table(table, "directions", "explore.") or {k: list(v) for k, v in _AXES.items()}
            ).items()
        }
        self.names(directions, "explore.directions")
        return Limits(
            furthest,
            self.positive(table, "explore.force", "N"),
            self.positive(table, "explore.strain", ""),
            tuple(sorted(amplitudes, reverse=True)),
            directions,
            self.count(table, "explore.steps", 4, 2, 50),
            self.positive(table, "explore.cost", "") or 1.0,
            self.positive(table, "explore.regrasp", "", zero=True) or 0.0,
        )

    def uncertainty(self, table: Mapping[str, Any]) -> Uncertainty:
        """How well the scene knows what it states."""
        units = {field.name: "" for field in fields(Uncertainty)}
        units |= dict.fromkeys(LENGTHS, "m") | dict.fromkeys(ANGLES, "deg") | dict.fromkeys(FORCES, "N")
        self.unknown(table, tuple(units), "uncertainty.")
        return Uncertainty(
            **{name: self.positive(table, f"uncertainty.{name}", unit, zero=True) for name, unit in units.items()}
        )

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

    def count(self, table: Mapping[str, Any], key: str, default: int, least: int, most: int) -> int:
        """A whole number within bounds."""
        value = table.get(key.rpartition(".")[2], default)
        if type(value) is int and least <= value <= most:
            return value
        self.bad(key, f"expected a whole number from {least} to {most}, found {value!r}")
        return default

    def geometry(self, table: Mapping[str, Any]) -> tuple[Path, float, dict[str, float]]:
        self.unknown(table, ("file", "length_unit", "parameters"), "geometry.")
        name = self.text(table, "file", where="geometry.")
        unit_text = self.text(table, "length_unit", where="geometry.")
        unit = 1.0
        if unit_text:
            try:
                unit = unit_factor(unit_text, "m")
            except InputError as error:
                self.bad("geometry.length_unit", str(error))
        path = self.path.parent / name if name else self.path
        if name and not path.is_file():
            self.bad("geometry.file", f"'{name}': no such file (looked at {path})")
        return path, unit, self.parameters(table, path.suffix == ".geo")

    def parameters(self, table: Mapping[str, Any], geo: bool) -> dict[str, float]:
        """Numbers that a `.geo` asks for, in its own units; names are those of gmsh."""
        entries = table.get("parameters", {})
        if not isinstance(entries, dict) or (entries and not geo):
            self.bad("geometry.parameters", "expected a table of the numbers that a .geo asks for, as { shift_z = 5 }")
            return {}
        found = {}
        for name, value in entries.items():
            number = type(value) in (int, float) and usable(value)
            if number and name.isidentifier() and name != "h":
                found[name] = float(value)
            else:
                rule = (
                    "the element size is that of the levels"
                    if name == "h"
                    else f"expected a number not beyond 1e30, found {value!r}"
                )
                self.bad(f"geometry.parameters.{name}", rule)
        return found

    def levels(self, value: object, geometry: Path) -> tuple[Level, ...]:
        if not isinstance(value, list) or not value or not all(isinstance(entry, dict) for entry in value):
            self.bad("levels", "expected at least one [[levels]] table, coarsest first")
            return (Level(),)
        return tuple(self.level(entry, f"levels[{i}].", geometry.suffix == ".geo") for i, entry in enumerate(value))

    def level(self, table: Mapping[str, Any], where: str, geo: bool) -> Level:
        size = "element_size" if geo else "refinements"
        self.unknown(table, ("degree", size), where)
        degree = table.get("degree", 1)
        if type(degree) is not int or degree not in DEGREES:
            self.bad(where + "degree", f"expected 1 or 2, found {degree!r}")
            degree = 1
        if geo:
            if "element_size" not in table:
                self.bad(where + "element_size", 'is missing: write element_size = "10 mm"')
                return Level(degree)
            return Level(degree, self.length(table["element_size"], where + "element_size"))
        count = table.get("refinements", 0)
        if not isinstance(count, int) or isinstance(count, bool) or not 0 <= count <= 4:
            self.bad(where + "refinements", f"expected a whole number from 0 to 4, found {count!r}")
            count = 0
        return Level(degree, None, count)

    def material(self, table: Mapping[str, Any]) -> Material:
        law = self.text(table, "law", "neo_hooke", "material.")
        formulation = self.text(table, "formulation", "displacement", "material.")
        if formulation not in FORMULATIONS:
            self.bad("material.formulation", f"{formulation!r}: {nearest(formulation, FORMULATIONS)}")
        values = {key: value for key, value in table.items() if key not in ("law", "formulation")}
        self.values(values, "material.")
        return Material(law, values, formulation)

    def values(self, table: Mapping[str, Any], where: str) -> None:
        for key, value in table.items():
            if isinstance(value, bool) or not isinstance(value, str | int | float | list):
                self.bad(where + key, f"expected a number or text with a unit, found {value!r}")
            elif isinstance(value, float) and not math.isfinite(value):
                self.bad(where + key, f"{value!r} is not a finite number")
            elif isinstance(value, float) and not usable(value):
                self.bad(where + key, f"{value!r} is too large or too small; expected a number from 1e-30 to 1e30")

    def effect(self, value: object, name: str) -> Values:
        if not isinstance(value, dict):
            self.bad(f"effects.{name}", f"expected a table of parameters, found {value!r}")
            return {}
        self.values(value, f"effects.{name}.")
        return value

    def divide(self, patches: Mapping[str, Any]) -> dict[str, float]:
        """Size (m) of the pieces of every patch that is divided."""
        found = {}
        for name, value in patches.items():
            if not isinstance(value, dict) or "divide" not in value:
                continue
            found[name] = self.length(value["divide"], f"patches.{name}.divide")
            for other in patches:
                if re.fullmatch(rf"{re.escape(name)}\.[0-9]+", other):
                    self.bad(f"patches.{name}", f"patch '{other}' has the name of a piece of it; rename one of them")
        return found

    def region(self, value: object, key: str, more: tuple[str, ...] = ()) -> Region:
        """A region; `more` are keys that its table may have for somebody else."""
        if isinstance(value, str | list):
            return Region(self.groups(value, key))
        if not isinstance(value, dict) or not ({"on", "box", "plane"} & set(value)):
            self.bad(key, 'expected a physical group ("name"), a list of them, or a table with on, box and/or plane')
            return Region()
        self.unknown(value, ("on", "box", "plane", *more), key + ".")
        groups = self.groups(value["on"], f"{key}.on") if "on" in value else ()
        return Region(groups, self.box(value.get("box"), key), self.plane(value.get("plane"), key))

    def groups(self, value: object, key: str) -> tuple[str, ...]:
        """Names of physical groups: one, or a list."""
        names = [value] if isinstance(value, str) else value
        if isinstance(names, list) and names and all(isinstance(name, str) and name for name in names):
            return tuple(names)
        self.bad(key, f"expected names of physical groups, found {value!r}")
        return ()

    def box(self, value: object, key: str) -> Box | None:
        if value is None:
            return None
        if not isinstance(value, list) or len(value) != 2:
            self.bad(key, f'box: expected two corners, as ["0 0 50 mm", "0 10 100 mm"], found {value!r}')
            return None
        a, b = (self.vector(corner, key) for corner in value)
        if any(low > high for low, high in zip(a, b, strict=True)):
            self.bad(key, f"box: the first corner must not exceed the second in any axis, found {value!r}")
        return Box(a, b)

    def plane(self, value: object, key: str) -> Plane | None:
        if value is None:
            return None
        if not isinstance(value, dict) or set(value) != {"point", "normal"}:
            self.bad(key, f'plane: expected {{ point = "0 0 0 mm", normal = [0, 1, 0] }}, found {value!r}')
            return None
        return Plane(self.vector(value["point"], key), self.direction(value["normal"], key))

    def grasp(self, value: object, key: str) -> Grasp:
        if not isinstance(value, dict) or not {"on", "centre"} <= set(value):
            self.bad(key, 'expected on = "physical group" and centre = "x y z mm"')
            return Grasp(Region(), (0.0, 0.0, 0.0))
        self.unknown(value, ("on", "centre"), key + ".")
        return Grasp(self.region(value["on"], key + ".on"), self.vector(value["centre"], key + ".centre"))
