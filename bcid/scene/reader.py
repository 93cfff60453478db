"""Reading a scene from TOML: validated as a whole, every problem told at once, unknown keys refused."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from bcid.base.errors import nearest
from bcid.base.units import LEAST_SIGMA, measurable
from bcid.scene.geometry_tables import GeometryTables
from bcid.scene.parts import LEAST_POINTS, MID_PLANE, SURFACE_DIRECTIONS, Driven, Limits, Material, Values, Vector
from bcid.scene.region_tables import RegionTables
from bcid.scene.uncertainty import ANGLES, FORCES, LENGTHS, MOST_SCALE, NUMBERS, Uncertainty

FORMAT = "bcid-scene/1"
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
    "held",
    "driven",
    "regions",
    "effects",
    "explore",
    "uncertainty",
)
_EXPLORE = ("displacement", "force", "strain", "amplitudes", "directions", "steps", "cost", "regrasp")
_AXES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}


class SceneFile(GeometryTables, RegionTables):
    """Turns the tables of a scene file into the fields of a `Scene`, noting every problem on the way."""

    def fibre_plane(self, value: object) -> tuple[Vector, Vector] | None:
        """Two directions that are perpendicular to each other."""
        if not isinstance(value, list) or len(value) != 2:
            self.bad("fibre_plane", f"expected two directions, as [[1, 0, 0], [0, 0, 1]]; found {value!r}")
            return None
        first, second = (self.direction(one, "fibre_plane") for one in value)
        if abs(float(np.dot(first, second))) > 1e-6:
            self.bad("fibre_plane", f"the directions must be perpendicular to each other; found {value!r}")
        return first, second

    def fields(self) -> dict[str, Any]:
        """The fields of a `Scene` by name; worthless where problems were found."""
        table = self._table
        self.unknown(table, (*_VALUES, *_TABLES))
        if table.get("format") != FORMAT:
            self.bad("format", f'expected "{FORMAT}", found {table.get("format")!r}')
        optional = {key: self.length(table[key], key) for key in ("noise_sigma", "attach_within") if key in table}
        if not measurable(optional.get("noise_sigma", 1.0)):
            self.bad("noise_sigma", f"'{table['noise_sigma']}' is no noise; it must be at least {LEAST_SIGMA:g} m")
        geometry = self.geometry(self.table(table, "geometry"))
        patches = self.table(table, "patches")
        grasps = self.table(table, "grasps")
        places = self.table(table, "places")
        held = self.table(table, "held")
        fiducials = self.table(table, "fiducials")
        driven = self.table(table, "driven")
        body_regions = self.table(table, "regions")
        for what in ("patches", "grasps", "places", "held", "driven", "regions", "fiducials"):
            self.names(self.table(table, what), what)
        if "thickness" in geometry:
            for name in {MID_PLANE} & (set(held) | set(places)):
                self.bad(
                    "geometry.thickness",
                    f"the middle plane of a sheet is called '{name}'; give that place another name",
                )
            held = held | {MID_PLANE: {"on": MID_PLANE, "along": "z"}}
        for name in set(held) & set(places):
            self.bad(f"held.{name}", "has the name of one of [places]; choose another")
        for name in set(driven) & {*places, *held}:
            self.bad(f"driven.{name}", "has the name of one of [places] or [held]; choose another")
        if not (patches or self.table(table, "held") or driven):
            rule = "name at least one candidate patch, or what is known to be held in [held], or driven by points in [driven]"
            self.bad("patches", f"none is defined: {rule}")
        for name, value in body_regions.items():
            if isinstance(value, dict) and "label" in value and geometry["label"] is None:
                self.bad(f"regions.{name}.label", "only a label image (.nii, .nii.gz) has labels; name another shape")
            elif isinstance(value, dict) and "label" in value and value["label"] == geometry["label"]:
                self.bad(f"regions.{name}.label", f"{value['label']} is the label of the body itself; name another one")
        if not fiducials:
            self.bad("fiducials", 'none is defined: write name = "x y z mm" for each marker')
        support = self.text(table, "support", "")
        if support and support not in places:
            self.bad("support", f"place '{support}' is not defined; {nearest(support, places)}")
        return {
            "name": self.text(table, "name", self.path.stem),
            **geometry,
            "levels": self.levels(table.get("levels"), geometry["geometry"]),
            "material": self.material(self.table(table, "material")),
            "patches": {
                name: self.region(value, f"patches.{name}", ("divide", "along")) for name, value in patches.items()
            },
            "grasps": {name: self.grasp(value, f"grasps.{name}") for name, value in grasps.items()},
            "fiducials": {name: self.vector(value, f"fiducials.{name}") for name, value in fiducials.items()},
            "places": {name: self.region(value, f"places.{name}") for name, value in places.items()}
            | {name: self.region(value, f"held.{name}", ("along",)) for name, value in held.items()}
            | {
                name: self.driven_region(value, f"driven.{name}")
                for name, value in driven.items()
                if name not in grasps
            },
            "held": {name: self.along(value, f"held.{name}") for name, value in held.items()},
            "driven": {name: self.driven(value, name, grasps, fiducials) for name, value in driven.items()},
            "regions": {name: self.body_region(value, f"regions.{name}") for name, value in body_regions.items()},
            "patch_axes": self.patch_axes(patches),
            "patch_directions": {name: one["along"] for name, one in patches.items() if _of_surface(one)},
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
        units = dict.fromkeys(NUMBERS, "")
        units |= dict.fromkeys(LENGTHS, "m") | dict.fromkeys(ANGLES, "deg") | dict.fromkeys(FORCES, "N")
        self.unknown(table, (*units, "scale_of_gripper"), "uncertainty.")
        numbers = {name: self.positive(table, f"uncertainty.{name}", unit, zero=True) for name, unit in units.items()}
        too = table.get("scale_of_gripper")
        if not isinstance(too, bool | None):
            self.bad("uncertainty.scale_of_gripper", f"expected true or false, found {too!r}")
            too = None
        if too and numbers["scale"] == 0:
            self.bad("uncertainty.scale_of_gripper", "the lengths share no factor that the path could have: scale is 0")
        if (numbers["scale"] or 0) > MOST_SCALE:
            self.bad("uncertainty.scale", f"{table['scale']!r} is no factor near 1; at most {MOST_SCALE} (0.02 is 2 %)")
        return Uncertainty(**numbers, scale_of_gripper=too)

    def material(self, table: Mapping[str, Any]) -> Material:
        law = self.text(table, "law", "neo_hooke", "material.")
        formulation = self.text(table, "formulation", "displacement", "material.")
        if formulation not in FORMULATIONS:
            self.bad("material.formulation", f"{formulation!r}: {nearest(formulation, FORMULATIONS)}")
        volumetric = self.text(table, "volumetric", "", "material.")
        values = {key: value for key, value in table.items() if key not in ("law", "formulation", "volumetric")}
        self.values(values, "material.")
        return Material(law, values, formulation, volumetric)

    def effect(self, value: object, name: str) -> Values:
        if not isinstance(value, dict):
            self.bad(f"effects.{name}", f"expected a table of parameters, found {value!r}")
            return {}
        self.values(value, f"effects.{name}.")
        return value

    def along(self, value: object, key: str, others: str = '"normal"') -> tuple[int, ...]:
        """Axes along which a place does not move: all, where none are named; none of them along its normal."""
        if not isinstance(value, dict) or "along" not in value:
            return (0, 1, 2)
        if value["along"] == "normal":
            return ()
        axes = [value["along"]] if isinstance(value["along"], str) else value["along"]
        if not isinstance(axes, list) or not axes or not all(axis in ("x", "y", "z") for axis in axes):
            self.bad(
                f"{key}.along", f'expected "x", "y" or "z", or a list of them, or {others}, found {value["along"]!r}'
            )
            return (0, 1, 2)
        return tuple(sorted({"xyz".index(axis) for axis in axes}))

    def driven(self, value: object, name: str, grasps: Mapping[str, Any], fiducials: Mapping[str, Any]) -> Driven:
        """Which points drive a place, or a grasp."""
        key = f"driven.{name}"
        if not isinstance(value, dict) or ("markers" in value) == ("near" in value):
            self.bad(
                key,
                'expected what drives it: markers = ["a", "b", "c"], or near = "2 mm" for all that are not further away',
            )
            return Driven()
        if name in grasps:
            self.unknown(value, ("markers", "near"), f"{key}.")
        markers = value.get("markers", [])
        if not isinstance(markers, list) or not all(isinstance(one, str) for one in markers):
            self.bad(f"{key}.markers", f'expected names of fiducials, as ["a", "b", "c"], found {markers!r}')
            return Driven()
        if "markers" in value and len(set(markers)) < LEAST_POINTS:
            self.bad(f"{key}.markers", f"expected {LEAST_POINTS} different fiducials or more, found {markers!r}")
        for unknown in set(markers) - set(fiducials):
            self.bad(f"{key}.markers", f"fiducial '{unknown}' is not defined; {nearest(unknown, fiducials)}")
        near = self.length(value["near"], f"{key}.near") if "near" in value else None
        along = self.along(value, key)
        if not along:
            self.bad(f"{key}.along", 'expected "x", "y" or "z", or a list of them: points drive along axes')
        return Driven(tuple(dict.fromkeys(markers)), near, along or (0, 1, 2))

    def patch_axes(self, patches: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
        """Axes along which a patch holds, of those that do not hold along all."""
        found = {}
        for name, value in patches.items():
            if _of_surface(value):
                continue
            axes = self.along(value, f"patches.{name}", '"normal" or "tangent"')
            if len(axes) < 3:
                found[name] = axes
        return found

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


def _of_surface(patch: object) -> bool:
    """Whether an entry of [patches] holds along a direction of its surface."""
    return isinstance(patch, dict) and patch.get("along") in SURFACE_DIRECTIONS
