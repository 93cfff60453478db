"""Parts of boundary and body in a scene file: physical groups, boxes, planes, spheres, normals, painted fields, outlines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bcid.base.units import usable
from bcid.scene.parts import BodyRegion, Box, Facing, Grasp, Painted, Plane, Polygon, Region, Sphere, Values
from bcid.scene.scene_tables import SceneTables

# What chooses facets, and the keys that go with some of it.
_CRITERIA = ("on", "box", "plane", "sphere", "normal", "painted")
_BESIDE = {"normal": "within", "painted": "value"}
# What chooses a part of the volume.
_SHAPES = ("volume", "box", "sphere", "outline", "label")


class RegionTables(SceneTables):
    """The entries of [patches], [grasps], [places] and [regions]."""

    def region(self, value: object, key: str, more: tuple[str, ...] = ()) -> Region:
        """A region; `more` are keys that its table may have for somebody else."""
        if isinstance(value, str | list):
            return Region(self.groups(value, key))
        if not isinstance(value, dict) or not set(_CRITERIA) & set(value):
            rule = f"a table with {', '.join(_CRITERIA[:-1])} and/or {_CRITERIA[-1]}"
            self.bad(key, f'expected a physical group ("name"), a list of them, or {rule}')
            return Region()
        self.unknown(value, (*_CRITERIA, *_BESIDE.values(), *more), key + ".")
        return Region(
            groups=self.groups(value["on"], f"{key}.on") if "on" in value else (),
            box=self.box(value.get("box"), key),
            plane=self.plane(value.get("plane"), key),
            sphere=self.sphere(value.get("sphere"), key),
            facing=self.facing(value, key),
            painted=self.painted(value, key),
        )

    def driven_region(self, value: object, key: str) -> Region:
        """The place of an entry of [driven]."""
        if not isinstance(value, dict) or not set(_CRITERIA) & set(value):
            self.bad(key, f"expected the name of a grasp, or a place on the boundary by {', '.join(_CRITERIA)}")
            return Region()
        return self.region(value, key, ("markers", "near", "along"))

    def body_region(self, value: object, key: str) -> BodyRegion:
        """A part of the volume."""
        if not isinstance(value, dict) or not set(_SHAPES) & set(value):
            rule = f"a table with {', '.join(_SHAPES[:-1])} and/or {_SHAPES[-1]}"
            self.bad(
                key, f'expected {rule}, as {{ volume = "scar" }} or {{ sphere = {{ centre = ..., radius = ... }} }}'
            )
            return BodyRegion()
        self.unknown(value, (*_SHAPES, "along", "ratio", "constants"), key + ".")
        return BodyRegion(
            volumes=self.groups(value["volume"], f"{key}.volume") if "volume" in value else (),
            box=self.box(value.get("box"), key),
            sphere=self.sphere(value.get("sphere"), key),
            outline=self.outline(value, key),
            ratio=self.positive(value, f"{key}.ratio", ""),
            label=self.region_label(value["label"], f"{key}.label") if "label" in value else None,
            constants=self.region_constants(value, key),
        )

    def region_constants(self, region: Mapping[str, Any], key: str) -> Values:
        """Constants of the law that a region has of its own; what they may be is the business of the law."""
        found = self.table(region, "constants", key + ".")
        self.values(found, f"{key}.constants.")
        if "constants" in region and not found:
            self.bad(f"{key}.constants", "names none: write constants = { poisson = 0.3 }, or leave it out")
        both = sorted(set(found) - {"poisson"})
        if both and "ratio" in region:
            rule = "ratio multiplies all stiffnesses of the body, and of the constants only poisson may stand beside it"
            self.bad(f"{key}.constants.{both[0]}", f"there is a ratio as well; {rule}: leave one of them out")
        return found

    def region_label(self, value: object, key: str) -> int | None:
        if type(value) is int and value != 0 and usable(value):
            return value
        self.bad(
            key, f"expected the number that it has in the image, as label = 3 (0 is what is around it), found {value!r}"
        )
        return None

    def outline(self, table: Mapping[str, Any], key: str) -> Polygon | None:
        if "outline" not in table:
            if "along" in table:
                self.bad(f"{key}.along", "belongs to an outline, and there is none")
            return None
        corners = table["outline"]
        if not isinstance(corners, list) or len(corners) < 3:
            self.bad(
                f"{key}.outline", f'expected three corners or more, as ["0 0 0 mm", "9 0 0 mm", ...], found {corners!r}'
            )
            return None
        if "along" not in table:
            self.bad(f"{key}.along", "is missing: from where the outline is seen, as along = [0, 0, 1]")
            return None
        points = tuple(self.vector(corner, f"{key}.outline") for corner in corners)
        return Polygon(points, self.direction(table["along"], f"{key}.along"))

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

    def sphere(self, value: object, key: str) -> Sphere | None:
        if value is None:
            return None
        if not isinstance(value, dict) or set(value) != {"centre", "radius"}:
            self.bad(key, f'sphere: expected {{ centre = "0 0 50 mm", radius = "10 mm" }}, found {value!r}')
            return None
        return Sphere(self.vector(value["centre"], key), self.length(value["radius"], key))

    def facing(self, table: Mapping[str, Any], key: str) -> Facing | None:
        if not self._both(table, "normal", key, 'normal = [0, -1, 0], within = "30 deg"'):
            return None
        angle = self.positive(table, f"{key}.within", "deg") or 30.0
        if angle >= 180:
            self.bad(f"{key}.within", f"expected an angle below 180 deg, found {table['within']!r}")
        return Facing(self.direction(table["normal"], f"{key}.normal"), angle)

    def painted(self, table: Mapping[str, Any], key: str) -> Painted | None:
        if not self._both(table, "painted", key, 'painted = "attachment", value = 1'):
            return None
        field, value = self.text(table, "painted", where=f"{key}."), table["value"]
        numbers = value if isinstance(value, list) and len(value) == 3 else [value]
        if not all(type(v) in (int, float) and usable(v) for v in numbers):
            rule = "expected a number, or three of a colour from 0 to 255"
            self.bad(f"{key}.value", f"{rule}, found {value!r}")
            return None
        return Painted(field, tuple(map(float, numbers)))

    def _both(self, table: Mapping[str, Any], first: str, key: str, example: str) -> bool:
        """Whether a key stands in a table together with the one that goes with it; one without the other is a problem."""
        given = [name for name in (first, _BESIDE[first]) if name in table]
        if len(given) == 1:
            self.bad(
                key, f"'{first}' and '{_BESIDE[first]}' go together, as {{ {example} }}; only '{given[0]}' is there"
            )
        return len(given) == 2

    def grasp(self, value: object, key: str) -> Grasp:
        if not isinstance(value, dict) or not {"on", "centre"} <= set(value):
            self.bad(key, 'expected on = "physical group" and centre = "x y z mm"')
            return Grasp(Region(), (0.0, 0.0, 0.0))
        self.unknown(value, ("on", "centre"), key + ".")
        return Grasp(self.region(value["on"], key + ".on"), self.vector(value["centre"], key + ".centre"))
