"""What was found of a scene, as a table of text: lengths in mm, areas in mm^2 or cm^2."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from bcid.forms.mesh import level_name
from bcid.forms.mesh.body_mesh import triple
from bcid.forms.mesh.check import sheet_in_words, shown
from bcid.forms.scene_check import LevelSize, Marker, PlaceSize, RegionSize, SceneCheck
from bcid.scene import Scene


def table(check: SceneCheck) -> str:
    """Everything that `bcid scene check` prints."""
    scene, mesh = check.scene, check.mesh
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    lines = [
        f"{scene.name}: {scene.geometry.name}, volume {shown(mesh.volume, 3)}, boundary {shown(mesh.area(mesh.boundary), 2)}, "
        f"from {_mm(low)} to {_mm(high)} mm",
        "",
        *columns(("level", "degree", "nodes", "cells", "unknowns"), [_rung(scene, rung) for rung in check.rungs]),
    ]
    lines[1:1] = sheet_in_words(scene, mesh)
    kinds = {place.kind: [one for one in check.places if one.kind == place.kind] for place in check.places}
    for kind, found in kinds.items():
        lines += ["", f"On {level_name(scene, scene.levels[check.level])}:"] if kind == "patch" else [""]
        lines += columns(
            (kind, "facets", "area", "middle (mm)", *_more(check, kind)), [_place(check, one) for one in found]
        )
    if check.body_regions:
        rows = [_region(scene, one) for one in check.body_regions]
        lines += ["", *columns(("region", "of the volume", "cells cut", "middle (mm)", "stiffness"), rows)]
    lines += ["", *columns(("fiducial", "position (mm)", "from the surface"), map(_marker, check.markers))]
    return "\n".join([*lines, "", *_warnings(check.warnings)])


def _mm(place: NDArray[np.float64]) -> str:
    """A place (m) in mm, to the micrometre."""
    return triple(np.round(place * 1e3, 3) + 0.0)


def _warnings(texts: Sequence[str]) -> list[str]:
    return [f"note: {text}" for text in texts] or ["Nothing looks odd."]


def columns(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table, columns wide enough and two blanks apart."""
    whole = [tuple(head), *map(tuple, rows)]
    wide = [max(len(row[i]) for row in whole) for i in range(len(head))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, wide, strict=True)).rstrip() for row in whole]


def _rung(scene: Scene, rung: LevelSize) -> tuple[str, ...]:
    about = "" if rung.meshed else "about "
    numbers = (rung.nodes, rung.cells, rung.unknowns)
    return (
        level_name(scene, rung.level),
        str(rung.level.degree),
        *(f"{about}{number if rung.meshed else float(f'{number:.2g}'):,.0f}" for number in numbers),
    )


def _more(check: SceneCheck, kind: str) -> tuple[str, ...]:
    if kind == "patch":
        return ("holds along",) if _hold_along_some(check.scene) else ()
    return {"grasp": ("centre (mm)",), "held": ("along",), "driven": ("along", "by")}.get(kind, ())


def _hold_along_some(scene: Scene) -> bool:
    """Whether a patch does not hold along all axes."""
    return bool(scene.patch_axes or scene.patch_directions)


def _place(check: SceneCheck, place: PlaceSize) -> tuple[str, ...]:
    area = shown(place.area, 2) if place.area > 0 else "none"
    found = place.name, str(place.facets), area, _mm(place.middle)
    if place.kind == "held":
        return *found, " ".join("xyz"[axis] for axis in check.scene.held[place.name]) or "its normal"
    if place.kind == "patch" and _hold_along_some(check.scene):
        return *found, check.scene.held_in_words(place.name)
    if place.kind == "driven":
        along = " ".join("xyz"[axis] for axis in check.scene.driven[place.name].along)
        return *found, along, f"{check.drivers[place.name]} fiducials"
    if place.kind != "grasp":
        return found
    centre = check.scene.grasps[place.name].centre
    return *found, _mm(np.array(centre))


def _region(scene: Scene, region: RegionSize) -> tuple[str, ...]:
    ratio = scene.regions[region.name].ratio
    constants = scene.regions[region.name].constants
    stiffness = "not known" if ratio is None else f"{ratio:g} times that of the body"
    if constants:
        own = ", ".join(f"{name} = {value}" for name, value in constants.items())
        stiffness = f"{stiffness}; {own}" if set(constants) == {"poisson"} else own
    return region.name, f"{100 * region.part:.3g} %", str(region.cut), _mm(region.middle), stiffness


def _marker(marker: Marker) -> tuple[str, ...]:
    away = abs(marker.distance) * 1e3
    side = "on it" if away < 0.05 else f"{away:.2g} mm {'outside' if marker.distance > 0 else 'inside'}"
    return marker.name, _mm(marker.position), side
