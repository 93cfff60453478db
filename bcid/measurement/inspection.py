"""`bcid import`: what is in a file, and a mapping that reads it, with what is left to say as comments."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcid.base.errors import InputError
from bcid.base.run_folder import write_whole, writing
from bcid.base.text_file import read_export
from bcid.base.units import unit_factor
from bcid.measurement.formats.dic_export import lacking
from bcid.measurement.formats.foreign import CORRELATION, Foreign
from bcid.measurement.formats.recognise import TABLE, Format, files, recognise
from bcid.measurement.guess import guess_arrays, guess_table
from bcid.measurement.mapping import FORMAT, read_mapping
from bcid.measurement.tracks import displaced_at_first, read_foreign, read_table, with_rest

if TYPE_CHECKING:
    from bcid.scene import Scene

# Lines in which a header is looked for.
_HEADER = 50
# Markers that are named one by one.
_NAMED = 24
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_MOVED_AT_FIRST = (
    'rest = "reference"          # the state from which displacements count: the first frame is no rest',
    "# first = 0                 # first frame that is used, from 0",
)
_AT_REST_AT_FIRST = (
    "first = 0                   # first frame that is used, from 0; the gripper is at rest in it, unless:",
    "# rest = 0                  # another frame of rest, before the first",
)
_ABOUT = {"wrench": "   # of the gripper on the body, about the grasp centre, body frame"}
# More points than this make every n-th a fiducial.
_MOST_POINTS = 500


@dataclass(frozen=True)
class Inspected:
    """What was found, and what was written.

    Attributes:
        seen: the content.
        unit: of lengths, as the mapping has it.
        mapping: the mapping file.
        fiducials: file with the table [fiducials] for a scene, of points without names; None for others.
        text: all that in words.
    """

    seen: Foreign
    unit: str
    mapping: Path
    fiducials: Path | None
    text: str


def import_file(source: Path, target: Path | None = None, scene: Scene | None = None) -> Inspected:
    """Look at a file, or at files of a pattern, and write a mapping that reads it.

    Args:
        source: the recording.
        target: mapping to write; by default beside the recording, under its name.
        scene: whose fiducials and grasps are looked for.

    Raises:
        InputError: the file is missing, damaged or of no known format; or the mapping exists.
        MachineError: the mapping cannot be written.
    """
    found = files(source.parent, source.name)
    if not found:
        rule = "expected a recording, or a pattern as 'frame_*.csv' for one file a frame"
        raise InputError(f"{source}: no such file; {rule}")
    target = target or found[0].with_name(f"{_stem(source)}.toml")
    if target.suffix != ".toml":
        raise InputError(f"{target}: a mapping is a TOML file; choose a name that ends in .toml")
    extra = target.with_name(f"{target.stem}-fiducials.toml")
    for path in (target, extra):
        if path.exists():
            raise InputError(f"{path}: exists already; choose another name with -o, or remove it")
    known = recognise(found[0])
    told = _guess(found[0], known)
    file = os.path.relpath(source.parent.resolve() / source.name, target.parent.resolve())
    # Under another name first: a mapping that does not read its file is not left behind.
    partial = target.with_name(f".{target.stem}.partial.toml")
    try:
        _check_unit(found[0], told.get("length_unit", ""))
        seen = _read(partial, file, known, told)
        labelled = known is not TABLE and "table" not in told
        _write(partial, mapping_lines(file, told, seen if labelled else None, scene))
        unit = read_mapping(partial).units.length
        dense = with_rest(seen) if seen.numbered else None
        if dense is not None:
            _write(extra, scene_lines(dense, unit))
        with writing(target):
            partial.replace(target)
    except BaseException:
        # What cannot be written cannot be removed either, and is not there.
        for begun in (partial, extra):
            with suppress(OSError):
                begun.unlink(missing_ok=True)
        raise
    points = None if dense is None else extra
    text = _text(source, seen, unit, [target] if points is None else [target, points])
    return Inspected(seen, unit, target, points, text)


def _stem(source: Path) -> str:
    """A name for the mapping of a file or of a pattern."""
    return "".join(c for c in source.stem if c not in "*?[]").rstrip("_-. ") or "mapping"


def _guess(path: Path, known: Format) -> dict[str, Any]:
    """Keys of a mapping that are known before the file is read."""
    if known.arrays:
        return guess_arrays(path)
    if known is not TABLE:
        return {}
    # A table of displacements may lack some of what makes it one.
    if said := lacking("\n".join(read_export(path)[:_HEADER])):
        raise InputError(f"{path}: {said}")
    told = guess_table(path)
    if not told["fiducials"] and "position" not in told["columns"]:
        raise InputError(
            f"{path}: no columns of its first line are coordinates, as tip_x,tip_y,tip_z, and no other format is known by it; "
            "write a mapping by hand (docs/formats.md)"
        )
    return told


def _read(partial: Path, file: str, known: Format, told: dict[str, Any]) -> Foreign:
    """The content, read through a first mapping that has what was guessed alone."""
    _write(partial, mapping_lines(file, told, None, None))
    mapping = read_mapping(partial)
    if mapping.labelled:
        seen = read_foreign(mapping)
        if not seen.frames:
            raise InputError(f"{mapping.file}: holds no frame; export it again")
        seen = with_rest(seen)
        _check_unit(mapping.file, seen.unit)
        return seen
    tracks, clocked = read_table(mapping), "time" in mapping.columns
    wrenches = {} if tracks.wrench is None else {"columns " + ", ".join(mapping.columns["wrench"]): tracks.wrench}
    times, unit = np.array(tracks.times, dtype=float) * mapping.time, told.get("length_unit", "")
    return Foreign(known.words, times, tracks.positions, wrenches=wrenches, unit=unit, clocked=clocked)


def _check_unit(path: Path, unit: str) -> None:
    """Refuse a unit that no mapping could name."""
    try:
        if unit:
            unit_factor(unit, "m")
    except InputError as error:
        raise InputError(f"{path}: states its lengths in '{unit}': {error}; export it again in mm") from None


def _write(path: Path, lines: list[str]) -> None:
    try:
        write_whole(path, "\n".join(lines) + "\n")
    except UnicodeEncodeError:
        raise InputError(f"{path}: cannot name a file or label that is not UTF-8; rename it first") from None


def _text(source: Path, seen: Foreign, unit: str, written: list[Path]) -> str:
    """What is in the file, in words."""
    span = float(seen.times[-1] - seen.times[0]) if seen.frames else 0.0
    timed = seen.clocked and np.isfinite(seen.rate)
    rate = f"{seen.rate:.4g} Hz, {span:.4g} s" if timed else "without times: fill in rate"
    stated = ", as the file states" if seen.unit else "? No unit is stated: check length_unit"
    lines = [f"{source}: {seen.format}", f"  {seen.frames} frame{'s' if seen.frames != 1 else ''}, {rate}"]
    lines += [f"  lengths in {unit}{stated}", f"  markers: {_parts(seen.points)}"]
    lines += [f"  rigid bodies: {_parts(seen.bodies)}"] if seen.bodies else []
    lines += [f"  forces: {_parts(seen.wrenches)}"] if seen.wrenches else []
    lines += [f"  {kind} of positions is there: see points in docs/formats.md" for kind in seen.quality]
    lines += [f"  {note}" for note in seen.notes[:10]]
    return "\n".join([*lines, *(f"wrote {path}" for path in written)])


def _parts(values: dict[str, Any]) -> str:
    """Labels with the part of the frames in which each is known, or their number where there are many."""
    part = {label: float(np.isfinite(at).all(axis=1).mean()) for label, at in values.items()}
    if len(part) > _NAMED:
        return f"{len(part)}, seen in {min(part.values()):.0%} to {max(part.values()):.0%} of the frames"
    return ", ".join(f"{label} {share:.0%}" for label, share in part.items()) or "none"


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
    if "arrays" in told:
        lines += ["", "[arrays]                    # guessed from shapes and names"]
        lines += [f"{key} = {_toml(value)}" for key, value in told["arrays"].items()]
    lines += _fiducials(told, seen, scene)
    moved = seen is not None and displaced_at_first(seen)
    lines += ["", "[frames]", *(_MOVED_AT_FIRST if moved else _AT_REST_AT_FIRST), "# last = 400", "# every = 10"]
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
    head = "# Paste into the scene. The positions are in the frame of the recording: the scene must have the same."
    places = {label: " ".join(f"{v:.10g}" for v in seen.rest[label]) for label in chosen_points(seen)[1]}
    return [head, "[fiducials]", *(f'"{label}" = "{place} {unit}"' for label, place in places.items())]


def _units(told: dict[str, Any], seen: Foreign | None) -> list[str]:
    stated = seen.unit if seen is not None else told.get("length_unit", "")
    why = "stated by the file" if stated else "a guess: the file states none"
    length = f'length_unit = "{stated or "mm"}"'
    return [f"{length:<27} # {why}", 'time_unit = "s"', 'force_unit = "N"']


def _gripper(told: dict[str, Any], seen: Foreign | None, scene: Scene | None, grasp: str | None) -> list[str]:
    """The grasp, and the columns of the gripper and of the forces."""
    names = ", ".join(scene.grasps) if scene is not None else "as the scene names it"
    lines = []
    if seen is not None and seen.displacements:
        lines.append(
            '# grasps = "grasps.csv"     # instead of grasp: poses of the gripper in each step (docs/measurement.md)'
        )
    lines.append(f"grasp = {_toml(grasp)}" if grasp else f'# grasp = "NAME"            # held in every action: {names}')
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
            chosen = f"every = {every}                   # of the {len(seen.points)} points, one in so many"
            lines = ["", "[points]", chosen]
            bound = "# least_correlation = 0.5   # points that are correlated worse count as not seen"
            return [*lines, bound] if CORRELATION in seen.quality else lines
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
    # A mapping without fiducials reads all markers: here they are to be named first.
    lines = ["", "[fiducials]"] if taken else [""]
    lines += [f"{_quoted(key)} = {_toml(markers[name])}{_part(seen.get(name))}" for name, key in taken.items()]
    if scene is not None:
        lost = [name for name in scene.fiducials if name not in taken.values()]
        lines += [f'# {_quoted(name)} = "?"           # fiducial of the scene: which marker is it?' for name in lost]
    left = [name for name in markers if name not in taken]
    if left:
        lines += ["", "# [reference]               # markers that only help to align"]
        lines += [f"# {_quoted(_key(name))} = {_toml(markers[name])}{_part(seen.get(name))}" for name in left]
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
    head = "# [align]                   # where three or more markers are in the body frame at rest, if it is another"
    if scene is None:
        return ["", head, "# NAME = [0.0, 0.0, 0.0]"]
    factor = unit_factor((seen.unit if seen is not None else told.get("length_unit", "")) or "mm", "m")
    places = {name: [float(f"{v / factor:.8g}") for v in place] for name, place in scene.fiducials.items()}
    return ["", head, *(f"# {_quoted(name)} = {place}" for name, place in list(places.items())[:50])]


def _toml(value: Any) -> str:
    """A value as TOML, which knows no surrogate pairs and has DEL escaped."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
