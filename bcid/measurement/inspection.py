"""`bcid import`: what is in a file, and a mapping that reads it."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcid.base.errors import InputError
from bcid.base.run_folder import write_whole, writing
from bcid.base.text_file import read_export
from bcid.base.units import unit_factor
from bcid.measurement.array_guess import guess_arrays
from bcid.measurement.formats.dic_export import lacking
from bcid.measurement.formats.foreign import Foreign
from bcid.measurement.formats.recognise import TABLE, Format, files, recognise
from bcid.measurement.mapped_points import read_foreign, with_rest
from bcid.measurement.mapped_table import read_table
from bcid.measurement.mapping import Mapping, read_mapping
from bcid.measurement.mapping_text import mapping_lines, scene_lines
from bcid.measurement.table_guess import guess_table

if TYPE_CHECKING:
    from bcid.scene import Scene

# Lines in which a header is looked for.
_HEADER = 50
# Markers that are named one by one.
_NAMED = 24


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
        raise InputError(
            f"{source}: no such file; expected a recording, or a pattern as 'frame_*.csv' for one file a frame"
        )
    target = target or found[0].with_name(f"{_stem(source)}.toml")
    if target.suffix != ".toml":
        raise InputError(f"{target}: a mapping is a TOML file; choose a name that ends in .toml")
    extra = target.with_name(f"{target.stem}-fiducials.toml")
    for path in (target, extra):
        if path.exists():
            raise InputError(f"{path}: exists already; choose another name with -o, or remove it")
    known = recognise(found[0])
    if known is TABLE:
        _refuse_part(found[0])
    told = _guess(found[0], known)
    file = os.path.relpath(source.parent.resolve() / source.name, target.parent.resolve())
    # Under another name first: a mapping that does not read its file is not left behind.
    partial = target.with_name(f".{target.stem}.partial.toml")
    try:
        _check_unit(found[0], told.get("length_unit", ""))
        seen = _read(partial, file, known, told)
        _write(partial, mapping_lines(file, told, seen if _labelled(known, told) else None, scene))
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
    written = [target, *([extra] if dense is not None else [])]
    return Inspected(
        seen, unit, target, extra if dense is not None else None, _text(source, found, seen, unit, written)
    )


def _refuse_part(path: Path) -> None:
    """Refuse a table of displacements that lacks some of what makes it one."""
    said = lacking("\n".join(read_export(path)[:_HEADER]))
    if said:
        raise InputError(f"{path}: {said}")


def _stem(source: Path) -> str:
    """A name for the mapping of a file or of a pattern."""
    return "".join(c for c in source.stem if c not in "*?[]").rstrip("_-. ") or "mapping"


def _labelled(known: Format, told: dict[str, Any]) -> bool:
    return known is not TABLE and "table" not in told


def _guess(path: Path, known: Format) -> dict[str, Any]:
    """Keys of a mapping that are known before the file is read."""
    if known.arrays:
        return guess_arrays(path)
    if known is not TABLE:
        return {}
    told = guess_table(path)
    if not told["fiducials"] and "position" not in told["columns"]:
        raise InputError(
            f"{path}: no columns of its first line are coordinates, as tip_x,tip_y,tip_z, and no other format is known by it; "
            "write a mapping by hand (docs/formats.md)"
        )
    return told


def _read(partial: Path, file: str, known: Format, told: dict[str, Any]) -> Foreign:
    """The content, read through a first mapping that has what was guessed alone."""
    first = mapping_lines(file, told, None, None)
    _write(partial, first)
    mapping = read_mapping(partial)
    if mapping.labelled:
        seen = read_foreign(mapping)
        if not seen.frames:
            raise InputError(f"{mapping.file}: holds no frame; export it again")
        seen = with_rest(seen)
        _check_unit(mapping.file, seen.unit)
        return seen
    return _of_table(mapping, known.words, told.get("length_unit", ""))


def _check_unit(path: Path, unit: str) -> None:
    """Refuse a unit that no mapping could name."""
    try:
        if unit:
            unit_factor(unit, "m")
    except InputError as error:
        raise InputError(f"{path}: states its lengths in '{unit}': {error}; export it again in mm") from None


def _of_table(mapping: Mapping, words: str, unit: str) -> Foreign:
    tracks = read_table(mapping)
    times = np.array(tracks.times, dtype=float) * mapping.time
    wrenches = {} if tracks.wrench is None else {"columns " + ", ".join(mapping.columns["wrench"]): tracks.wrench}
    return Foreign(words, times, tracks.positions, wrenches=wrenches, unit=unit, clocked="time" in mapping.columns)


def _write(path: Path, lines: list[str]) -> None:
    try:
        write_whole(path, "\n".join(lines) + "\n")
    except UnicodeEncodeError:
        raise InputError(f"{path}: cannot name a file or label that is not UTF-8; rename it first") from None


def _text(source: Path, found: list[Path], seen: Foreign, unit: str, written: list[Path]) -> str:
    """What is in the file, in words."""
    span = float(seen.times[-1] - seen.times[0]) if seen.frames else 0.0
    rate = (
        f", {seen.rate:.4g} Hz, {span:.4g} s"
        if seen.clocked and np.isfinite(seen.rate)
        else ", without times: fill in rate"
    )
    stated = (
        f"lengths in {unit}, as the file states"
        if seen.unit
        else f"lengths in {unit}? No unit is stated: check length_unit"
    )
    lines = [f"{source}: {seen.format}", f"  {seen.frames} frame{'s' if seen.frames != 1 else ''}{rate}", f"  {stated}"]
    lines.append(f"  markers: {_parts(seen.points)}")
    if seen.bodies:
        lines.append(f"  rigid bodies: {_parts(seen.bodies)}")
    if seen.wrenches:
        lines.append(f"  forces: {_parts(seen.wrenches)}")
    lines += [f"  {kind} of positions is there: see points in docs/formats.md" for kind in seen.quality]
    lines += [f"  {note}" for note in seen.notes[:10]]
    return "\n".join([*lines, *(f"wrote {path}" for path in written)])


def _parts(values: dict[str, Any]) -> str:
    """Labels with the part of the frames in which each is known, or their number where there are many."""
    part = {label: float(np.isfinite(at).all(axis=1).mean()) for label, at in values.items()}
    if len(part) > _NAMED:
        return f"{len(part)}, seen in {min(part.values()):.0%} to {max(part.values()):.0%} of the frames"
    return ", ".join(f"{label} {share:.0%}" for label, share in part.items()) or "none"
