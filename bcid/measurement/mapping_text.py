"""A mapping file as text, with what is known of a recording filled in and what is left as comments."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bcid.base.units import unit_factor
from bcid.measurement.formats.foreign import CORRELATION, Foreign
from bcid.measurement.mapped_points import displaced_at_first
from bcid.measurement.mapping import FORMAT

if TYPE_CHECKING:
    from bcid.scene import Scene

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_ABOUT = {"wrench": "   # of the gripper on the body, about the grasp centre, body frame"}
# More points than this make every n-th a fiducial.
_MOST_POINTS = 500


def mapping_lines(file: str, told: dict[str, Any], seen: Foreign | None, scene: Scene | None) -> list[str]:
    """Lines of a mapping.

    Args:
        file: as the mapping names it.
        told: keys that are known, as `bcid.measurement.inspection` guesses them.
        seen: what the file holds, where it names its markers itself; None for tables.
        scene: whose fiducials and grasps are meant; None where none is given.
    """
    lines = [f'format = "{FORMAT}"', f"file = {_toml(file)}", *_units(told, seen)]
    lines += [f"{key} = {_toml(told[key])}" for key in ("delimiter", "decimal", "table") if key in told]
    if seen is not None and not seen.clocked:
        lines.append("# rate = 100                # frames per second: the file has no times")
    lines.append("# noise_sigma = 0.1         # standard deviation of a coordinate, length_unit")
    grasp = next(iter(scene.grasps)) if scene is not None and len(scene.grasps) == 1 else None
    lines += _gripper(told, seen, scene, grasp)
    if seen is not None and seen.displacements:
        at = next(i for i, line in enumerate(lines) if "grasp =" in line)
        lines.insert(
            at,
            '# grasps = "grasps.csv"     # instead of grasp: poses of the gripper in each step (docs/measurement.md)',
        )
    if "arrays" in told:
        lines += ["", "[arrays]                    # guessed from shapes and names"]
        lines += [f"{key} = {_toml(value)}" for key, value in told["arrays"].items()]
    lines += _fiducials(told, seen, scene)
    lines += ["", "[frames]"]
    if seen is not None and displaced_at_first(seen):
        lines.append(
            'rest = "reference"          # the state from which displacements count: the first frame is no rest'
        )
        lines += ["# first = 0                 # first frame that is used, from 0", "# last = 400", "# every = 10"]
    else:
        lines.append(
            "first = 0                   # first frame that is used, from 0; the gripper is at rest in it, unless:"
        )
        lines += [
            "# rest = 0                  # another frame of rest, before the first",
            "# last = 400",
            "# every = 10",
        ]
    return lines + _align(seen, told, scene)


def chosen_points(seen: Foreign) -> tuple[int, list[str]]:
    """Of numbered points: every how many one becomes a fiducial, and the labels of those that are known at rest."""
    every = max(1, math.ceil(len(seen.points) / _MOST_POINTS))
    # Points on a grid that has as many in a row would all lie in one plane.
    while math.gcd(every, len(seen.points)) > 1:
        every += 1
    labels = list(seen.points)[::every]
    return every, [label for label in labels if label in seen.rest and np.isfinite(seen.rest[label]).all()]


def scene_lines(seen: Foreign, unit: str) -> list[str]:
    """The table [fiducials] of a scene with the rest positions of the points of a mapping."""
    head = [
        "# Paste into the scene. The positions are in the frame of the recording: the scene must have the same.",
        "[fiducials]",
    ]
    return head + [
        f'"{label}" = "{" ".join(f"{v:.10g}" for v in seen.rest[label])} {unit}"' for label in chosen_points(seen)[1]
    ]


def _units(told: dict[str, Any], seen: Foreign | None) -> list[str]:
    stated = seen.unit if seen is not None else told.get("length_unit", "")
    why = "stated by the file" if stated else "a guess: the file states none"
    length = f'length_unit = "{stated or "mm"}"'
    return [f"{length:<27} # {why}", 'time_unit = "s"', 'force_unit = "N"']


def _gripper(told: dict[str, Any], seen: Foreign | None, scene: Scene | None, grasp: str | None) -> list[str]:
    """The grasp, and the columns of the gripper and of the forces."""
    names = ", ".join(scene.grasps) if scene is not None else "as the scene names it"
    lines = [f"grasp = {_toml(grasp)}" if grasp else f'# grasp = "NAME"            # held in every action: {names}']
    columns = dict(told.get("columns", {}))
    bodies = list(seen.bodies) if seen is not None else []
    loose = [f"# pose = {_toml(label)}" for label in bodies]
    pose = columns.pop("pose", bodies[0] if len(bodies) == 1 else None)
    if pose is not None and grasp:
        columns["pose"], loose = pose, []
    elif pose is not None:
        loose = [f"# pose = {_toml(pose)}"]
    if loose:
        loose[0] += "        # rigid body whose pose is the gripper's; needs grasp"
    if pose is not None or bodies:
        lines.append(
            "# grasp_centre = [0, 0, 0]  # centre of the grasp at rest, body frame; else the origin of the rigid body"
        )
    forces = list(seen.wrenches) if seen is not None else []
    if "wrench" not in columns and forces:
        columns |= {"wrench": forces[0]} if len(forces) == 1 else {}
        loose += [f"# wrench = {_toml(label)}" for label in forces if len(forces) > 1]
    if "rotation" in told:
        loose.append(f"# rotation = {_toml(told['rotation'])}     # from rest; with translation = [x, y, z]")
    if columns or loose:
        given = [f"{key} = {_toml(value)}{_ABOUT.get(key, '')}" for key, value in columns.items()]
        lines += ["", "[columns]", *given, *loose]
    return lines


def _fiducials(told: dict[str, Any], seen: Foreign | None, scene: Scene | None) -> list[str]:
    if seen is None:
        return _table_of(told.get("fiducials", {}), {}, scene)
    if seen.numbered:
        every, labels = chosen_points(seen)
        if len(labels) == len(list(seen.points)[::every]):
            return [
                "",
                "[points]",
                f"every = {every}                   # of the {len(seen.points)} points, one in so many",
                *["# least_correlation = 0.5   # points that are correlated worse count as not seen"][
                    : CORRELATION in seen.quality
                ],
            ]
        return ["", "[fiducials]             # points that are known at rest", *(f'"{x}" = {x}' for x in labels)]
    labels = [label for label in seen.points if label not in seen.bodies] or list(seen.points)
    part = {label: float(np.isfinite(seen.points[label]).all(axis=1).mean()) for label in labels}
    return _table_of({label: label for label in labels}, part, scene)


def _table_of(markers: dict[str, Any], seen: dict[str, float], scene: Scene | None) -> list[str]:
    """[fiducials] and [reference]: of a scene those that have its names, the others as comments."""
    if not markers:
        return []
    named = {name: _same(name, list(scene.fiducials)) if scene is not None else _key(name) for name in markers}
    taken = {name: key for name, key in named.items() if key is not None}
    lines = ["", "[fiducials]"]
    for name, key in taken.items():
        lines.append(f"{_quoted(key)} = {_toml(markers[name])}{_part(seen.get(name))}")
    if scene is not None:
        lost = [name for name in scene.fiducials if name not in taken.values()]
        lines += [f'# {_quoted(name)} = "?"           # fiducial of the scene: which marker is it?' for name in lost]
    left = [name for name in markers if name not in taken]
    if left:
        lines += ["", "# [reference]               # markers that only help to align"]
        lines += [f"# {_quoted(_key(name))} = {_toml(markers[name])}{_part(seen.get(name))}" for name in left]
    if not taken:
        # A mapping without fiducials reads all markers: here they are to be named first.
        lines = [line for line in lines if line != "[fiducials]"]
    return lines


def _part(part: float | None) -> str:
    return "" if part is None or part == 1 else f"   # seen in {part:.0%} of the frames"


def _key(label: str) -> str:
    """A fiducial's name made of a label: without the subject, or the topic, before it."""
    return label if "/" in label else label.rpartition(":")[2] or label


def _same(label: str, names: Sequence[str]) -> str | None:
    """The name that is the same but for case, signs and what stands before a colon."""
    plain = {re.sub(r"[\W_]", "", name).casefold(): name for name in names}
    return plain.get(re.sub(r"[\W_]", "", _key(label)).casefold())


def _quoted(name: str) -> str:
    return name if _BARE.fullmatch(name) else _toml(name)


def _align(seen: Foreign | None, told: dict[str, Any], scene: Scene | None) -> list[str]:
    head = [
        "",
        "# [align]                   # where three or more markers are in the body frame at rest, if it is another",
    ]
    if scene is None:
        return [*head, "# NAME = [0.0, 0.0, 0.0]"]
    stated = (seen.unit if seen is not None else told.get("length_unit", "")) or "mm"
    factor = unit_factor(stated, "m")
    return head + [
        f"# {_quoted(n)} = {[float(f'{v / factor:.8g}') for v in p]}" for n, p in list(scene.fiducials.items())[:50]
    ]


def _toml(value: Any) -> str:
    """A value as TOML, which knows no surrogate pairs and has DEL escaped."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
