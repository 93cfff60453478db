"""The body in a scene file: its geometry, the unit of its coordinates, and the mesh ladder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bcid.base.errors import InputError
from bcid.base.units import unit_factor, usable
from bcid.scene.geometry_file import IMAGE, MESH, PROGRAM, kind_of, sized, stated_unit
from bcid.scene.parts import COMPUTED_THICKNESS, Level
from bcid.scene.scene_tables import SceneTables

DEGREES = (1, 2)


class GeometryTables(SceneTables):
    """The tables [geometry] and [[levels]]."""

    def geometry(self, table: Mapping[str, Any]) -> dict[str, Any]:
        """Fields of a `Scene` that [geometry] states."""
        self.unknown(table, ("file", "length_unit", "parameters", "label", "thickness", "wrinkles"), "geometry.")
        name = self.text(table, "file", where="geometry.")
        path = self.path.parent / name if name else self.path
        if name and not path.is_file():
            self.bad("geometry.file", f"'{name}': no such file (looked at {path})")
        return {
            "geometry": path,
            "length_unit": self.length_unit(table, path),
            "parameters": self.parameters(table, kind_of(path) == PROGRAM),
            "label": self.label(table, kind_of(path) == IMAGE),
            **self.thickness(table, kind_of(path) in (PROGRAM, MESH)),
            "wrinkles": self.wrinkles(table),
        }

    def thickness(self, table: Mapping[str, Any], may_be_flat: bool) -> dict[str, Any]:
        """Of a sheet that is given as a flat mesh: in m, and whether it is known; nothing for other bodies."""
        if "thickness" not in table:
            return {}
        value = table["thickness"]
        if not may_be_flat:
            self.bad("geometry.thickness", "only a .geo or a mesh file may be flat; leave it out")
        if value == "unknown":
            return {"thickness": COMPUTED_THICKNESS, "thickness_known": False}
        return {"thickness": self.length(value, "geometry.thickness")}

    def wrinkles(self, table: Mapping[str, Any]) -> bool:
        """Whether a sheet wrinkles where it would be pushed together in its plane."""
        value = table.get("wrinkles", False)
        if not isinstance(value, bool):
            self.bad("geometry.wrinkles", f"expected true or false, found {value!r}")
        elif value and "thickness" not in table:
            self.bad(
                "geometry.wrinkles",
                'only a sheet wrinkles: state its thickness, as thickness = "2 mm", or leave it out',
            )
        return value is True

    def length_unit(self, table: Mapping[str, Any], path: Path) -> float:
        """Unit of the coordinates, m: the scene's, or what an image states; where both do, they must agree."""
        found: float | None = None
        if kind_of(path) == IMAGE and path.is_file():
            try:
                found = stated_unit(path)
            except InputError as error:
                self.bad("geometry.file", str(error))
                return 1.0
        if found is not None and "length_unit" not in table:
            return found
        text = self.text(table, "length_unit", where="geometry.")
        try:
            unit = unit_factor(text, "m") if text else 1.0
        except InputError as error:
            self.bad("geometry.length_unit", str(error))
            return 1.0
        if found is not None and unit != found:
            self.bad("geometry.length_unit", f"'{text}', but {path.name} states a unit of {found:g} m; leave it out")
        return unit

    def label(self, table: Mapping[str, Any], image: bool) -> int | None:
        """Number of the body in a label image."""
        value = table.get("label")
        if not image:
            if value is not None:
                self.bad("geometry.label", "only a label image (.nii, .nii.gz) has labels; leave it out")
            return None
        if type(value) is not int or value == 0 or not usable(value):
            rule = "expected the number that the body has in the image, as label = 2 (0 is what is around it)"
            self.bad("geometry.label", f"{rule}, found {value!r}" if "label" in table else f"is missing: {rule}")
            return 1
        return value

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
        return tuple(self.level(entry, f"levels[{i}].", sized(geometry)) for i, entry in enumerate(value))

    def level(self, table: Mapping[str, Any], where: str, meshed: bool) -> Level:
        size = "element_size" if meshed else "refinements"
        self.unknown(table, ("degree", size), where)
        degree = table.get("degree", 1)
        if type(degree) is not int or degree not in DEGREES:
            self.bad(where + "degree", f"expected 1 or 2, found {degree!r}")
            degree = 1
        if meshed:
            if "element_size" not in table:
                self.bad(where + "element_size", 'is missing: write element_size = "10 mm"')
                return Level(degree)
            return Level(degree, self.length(table["element_size"], where + "element_size"))
        count = table.get("refinements", 0)
        if not isinstance(count, int) or isinstance(count, bool) or not 0 <= count <= 4:
            self.bad(where + "refinements", f"expected a whole number from 0 to 4, found {count!r}")
            count = 0
        return Level(degree, None, count)
