"""Foreign recordings: a mapping file (TOML) says which columns of a table, or which points of a C3D file, are what.

docs/measurement.md describes the format, with an example of each kind.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems, nearest
from bcid.base.text_file import read_lines, read_toml
from bcid.base.units import FURTHEST, unit_factor, usable
from bcid.measurement.alignment import align
from bcid.measurement.c3d import read_points
from bcid.measurement.contents import AXES, Contents, Units
from bcid.measurement.folder import frames_dataset

FORMAT = "bcid-mapping/1"
_UNITS = {"length_unit": "m", "time_unit": "s", "force_unit": "N"}
_KEYS = ("format", "file", *_UNITS, "noise_sigma", "description", "delimiter", "grasp", "action", "frames", "columns")
_KEYS += ("fiducials", "reference", "align")
_COLUMNS = ("action", "step", "time", "fiducial", "position", "grasp", "translation", "rotation")
_FRAMES = ("first", "last", "every")
# Coordinates above this, in length_unit, are taken for it, so that they can be turned.
_FAR = 1e100

Array = NDArray[np.float64]


@dataclass
class _Mapping:
    """The validated content of a mapping file."""

    path: Path
    file: Path
    units: Units
    length: float
    time: float
    table: dict[str, Any]
    columns: dict[str, Any]
    markers: dict[str, Any]
    fiducials: list[str]
    frames: tuple[int, int | None, int]
    align: dict[str, Array]


@dataclass
class _Recording:
    """What was read, in the file's units: one entry per frame; and by what the rigid motion of [align] misses its markers, m."""

    actions: list[str]
    steps: list[int]
    times: list[float]
    positions: dict[str, Array]
    translation: Array | None = None
    rotation: Array | None = None
    grasps: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    aligned: float | None = None


def read_mapped(path: Path) -> Contents:
    """Measurement from a mapping file and the recording it names.

    Raises:
        InputError: with every problem of the mapping, or of the recording.
    """
    mapping = _read_mapping(path)
    recording = _read_c3d(mapping) if mapping.file.suffix.lower() == ".c3d" else _read_table(mapping)
    _select(recording, mapping.frames, mapping.file)
    if not recording.actions:
        raise InputError(f"{path}: frames: no frame of {mapping.file.name} is left; check first, last and every")
    _to_body_frame(recording, mapping)
    return _contents(recording, mapping)


# -- the mapping file
# ----------------------------------------------------------------------------------------------------------


def _read_mapping(path: Path) -> _Mapping:
    table = read_toml(path)
    problems = Problems(f"mapping {path}")
    if table.get("format") != FORMAT:
        problems.add(path, f'format: expected "{FORMAT}", found {table.get("format")!r}')
    problems.add_unknown(path, table, _KEYS)
    tables = {
        key: _table(path, table, key, problems) for key in ("columns", "fiducials", "reference", "align", "frames")
    }
    for key, allowed in (("columns", _COLUMNS), ("frames", _FRAMES)):
        problems.add_unknown(path, tables[key], allowed, f"{key}.{{}}: unknown key; {{}}".format)
    factors = {key: _factor(path, table, key, like, problems) for key, like in _UNITS.items()}
    file = table.get("file")
    if not isinstance(file, str) or not (path.parent / file).is_file():
        problems.add(path, f"file: expected the name of a table or C3D file beside the mapping, found {file!r}")
    for key in ("grasp", "action", "description", "delimiter"):
        if not isinstance(table.get(key, ""), str):
            problems.add(path, f"{key}: expected text, found {table[key]!r}")
    if len(str(table.get("delimiter", ","))) != 1:
        problems.add(path, f"delimiter: expected one character, found {table.get('delimiter')!r}")
    sigma = table.get("noise_sigma")
    if sigma is not None and (
        isinstance(sigma, bool) or not isinstance(sigma, int | float) or not usable(sigma) or sigma <= 0
    ):
        problems.add(path, f"noise_sigma: expected a positive number up to 1e30, found {sigma!r}")
    _check_markers(path, tables, factors["length_unit"], str(file).lower().endswith(".c3d"), problems)
    frames = _frames(path, tables["frames"], problems)
    problems.raise_if_any()
    units = Units(*(str(table[key]) for key in _UNITS))
    align = {name: np.array(place, dtype=float) for name, place in tables["align"].items()}
    markers = tables["fiducials"] | tables["reference"]
    names = list(tables["fiducials"])
    factor = factors["length_unit"], factors["time_unit"]
    return _Mapping(
        path, path.parent / str(file), units, *factor, table, tables["columns"], markers, names, frames, align
    )


def _table(path: Path, table: dict[str, Any], key: str, problems: Problems) -> dict[str, Any]:
    value = table.get(key, {})
    if isinstance(value, dict):
        return value
    problems.add(path, f"{key}: expected a table, found {value!r}")
    return {}


def _factor(path: Path, table: dict[str, Any], key: str, like: str, problems: Problems) -> float:
    try:
        if not isinstance(table.get(key), str):
            raise InputError(f'is missing; write {key} = "{"mm" if like == "m" else like}"')
        return unit_factor(table[key], like)
    except InputError as error:
        problems.add(path, f"{key}: {error}")
        return 1.0


def _check_markers(path: Path, tables: dict[str, dict[str, Any]], length: float, c3d: bool, problems: Problems) -> None:
    long = "fiducial" in tables["columns"]
    if not tables["fiducials"] and not long:
        problems.add(path, "fiducials: name at least one, or give columns.fiducial and columns.position")
    for name, columns in (tables["fiducials"] | tables["reference"]).items():
        if c3d or long:
            if not isinstance(columns, str):
                problems.add(path, f"fiducials.{name}: expected the label of a marker, found {columns!r}")
        elif not _texts(columns, 3):
            problems.add(path, f'fiducials.{name}: expected three columns, as ["x", "y", "z"], found {columns!r}')
    for key, count in (("position", 3), ("translation", 3), ("rotation", 4)):
        if key in tables["columns"] and not _texts(tables["columns"][key], count):
            problems.add(
                path, f"columns.{key}: expected the names of {count} columns, found {tables['columns'][key]!r}"
            )
    for key in ("action", "step", "time", "fiducial", "grasp"):
        name = tables["columns"].get(key, key)
        if not isinstance(name, str) or not name:
            problems.add(path, f"columns.{key}: expected the name of a column, found {name!r}")
    for name, place in tables["align"].items():
        numbers = (
            isinstance(place, list)
            and len(place) == 3
            and all(type(v) in (int, float) and abs(v) * length <= FURTHEST for v in place)
        )
        if not numbers:
            problems.add(
                path, f"align.{name}: expected three numbers in length_unit, none beyond 1000 km, found {place!r}"
            )
        if not long and name not in tables["fiducials"] | tables["reference"]:
            problems.add(path, f"align.{name}: is neither in fiducials nor in reference")
    if 0 < len(tables["align"]) < 3:
        problems.add(path, "align: at least three markers, not on a line, fix a frame")


def _texts(value: object, count: int) -> bool:
    return isinstance(value, list) and len(value) == count and all(isinstance(v, str) and v for v in value)


def _frames(path: Path, table: dict[str, Any], problems: Problems) -> tuple[int, int | None, int]:
    first, last, every = table.get("first", 0), table.get("last"), table.get("every", 1)
    for name, value, least in (("first", first, 0), ("last", last, 0), ("every", every, 1)):
        if value is not None and (type(value) is not int or value < least):
            problems.add(path, f"frames.{name}: expected a whole number of at least {least}, found {value!r}")
    return first, last, every


# -- recordings
# ----------------------------------------------------------------------------------------------------------------


def _read_c3d(mapping: _Mapping) -> _Recording:
    points = read_points(mapping.file)
    problems = Problems(f"recording {mapping.file}")
    if points.unit not in ("", mapping.units.length):
        problems.add(
            mapping.path, f"length_unit is '{mapping.units.length}', but {mapping.file.name} states '{points.unit}'"
        )
    positions = {}
    for name, label in mapping.markers.items():
        if label not in points.labels:
            problems.add(mapping.file, f"has no point '{label}' (fiducial {name}); {nearest(label, points.labels)}")
            continue
        if points.labels.index(label) >= points.positions.shape[1]:
            problems.add(mapping.file, f"holds no data for point '{label}' (fiducial {name})")
            continue
        xyz = points.positions[:, points.labels.index(label)].T
        positions[name] = np.where(np.isfinite(xyz).all(axis=1, keepdims=True), xyz, np.nan)
    problems.raise_if_any()
    count = points.positions.shape[2]
    action = str(mapping.table.get("action", "1"))
    times = [i / points.rate / mapping.time for i in range(count)]
    return _Recording([action] * count, list(range(count)), times, positions)


def _read_table(mapping: _Mapping) -> _Recording:
    rows = _rows(mapping)
    if "fiducial" in mapping.columns:
        return _long(mapping, rows)
    columns = mapping.columns
    problems = Problems(f"recording {mapping.file}")
    wanted = [c for marker in mapping.markers.values() for c in marker]
    wanted += [c for key in _COLUMNS if key in columns for c in _listed(columns[key])]
    _require(mapping, rows, wanted, problems)
    actions = (
        [row[columns["action"]] for _, row in rows]
        if "action" in columns
        else [str(mapping.table.get("action", "1"))] * len(rows)
    )
    steps = _steps(mapping, rows, actions, problems)
    times = (
        _numbers(mapping, rows, [columns["time"]], problems)[:, 0]
        if "time" in columns
        else np.array(steps, dtype=float)
    )
    positions = {name: _numbers(mapping, rows, marker, problems, gaps=True) for name, marker in mapping.markers.items()}
    moved = [
        _numbers(mapping, rows, columns[k], problems) if k in columns else None for k in ("translation", "rotation")
    ]
    problems.raise_if_any()
    grasps = [row[columns["grasp"]] for _, row in rows] if "grasp" in columns else []
    return _Recording(actions, steps, list(times), positions, moved[0], moved[1], grasps)


def _long(mapping: _Mapping, rows: list[tuple[int, dict[str, str]]]) -> _Recording:
    """One row per frame and fiducial."""
    columns = mapping.columns
    problems = Problems(f"recording {mapping.file}")
    for key in ("position", "step"):
        if key not in columns:
            problems.add(mapping.path, f"columns.{key}: is needed when columns.fiducial is given")
    problems.raise_if_any()
    _require(mapping, rows, [c for key in _COLUMNS if key in columns for c in _listed(columns[key])], problems)
    action = str(mapping.table.get("action", "1"))
    actions = [row[columns["action"]] if "action" in columns else action for _, row in rows]
    steps = _steps(mapping, rows, actions, problems)
    values = _numbers(mapping, rows, columns["position"], problems, gaps=True)
    times = (
        _numbers(mapping, rows, [columns["time"]], problems)[:, 0]
        if "time" in columns
        else np.array(steps, dtype=float)
    )
    moved = [
        _numbers(mapping, rows, columns[k], problems) if k in columns else None for k in ("translation", "rotation")
    ]
    problems.raise_if_any()
    frames = list(dict.fromkeys(zip(actions, steps, strict=True)))
    first = {frame: i for i, frame in reversed(list(enumerate(zip(actions, steps, strict=True))))}
    chosen = [first[frame] for frame in frames]
    given = mapping.markers or {row[columns["fiducial"]]: row[columns["fiducial"]] for _, row in rows}
    if not mapping.fiducials:
        mapping.fiducials = [name for name in given if name]
    positions: dict[str, Array] = {name: np.full((len(frames), 3), np.nan) for name in given}
    names = {label: name for name, label in given.items()}
    labels = dict.fromkeys(row[columns["fiducial"]] for _, row in rows)
    for label, fiducial in names.items():
        if label not in labels:
            problems.add(mapping.file, f"has no marker '{label}' (fiducial {fiducial}); {nearest(label, labels)}")
    problems.raise_if_any()
    number = {frame: i for i, frame in enumerate(frames)}
    seen: dict[tuple[str, int, str], int] = {}
    for i, (line, row) in enumerate(rows):
        label = row[columns["fiducial"]]
        earlier = seen.setdefault((actions[i], steps[i], label), line)
        if earlier < line:
            what = f"a second row for marker {label}, step {steps[i]} of action {actions[i]}"
            problems.add(mapping.file, f"{what}; the first is in line {earlier}", line)
        elif label in names:
            positions[names[label]][number[actions[i], steps[i]]] = values[i]
    problems.raise_if_any()
    grasps = [rows[i][1][columns["grasp"]] for i in chosen] if "grasp" in columns else []
    parts = [None if m is None else m[chosen] for m in moved]
    return _Recording(
        [f[0] for f in frames], [f[1] for f in frames], list(times[chosen]), positions, parts[0], parts[1], grasps
    )


def _rows(mapping: _Mapping) -> list[tuple[int, dict[str, str]]]:
    reader = csv.reader(read_lines(mapping.file), delimiter=str(mapping.table.get("delimiter", ",")))
    problems = Problems(f"recording {mapping.file}")
    try:
        header = [name.strip() for name in next(reader, [])]
        rows = []
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                problems.add(
                    mapping.file, f"has {len(row)} values, the header names {len(header)} columns", reader.line_num
                )
                continue
            rows.append((reader.line_num, {name: cell.strip() for name, cell in zip(header, row, strict=True)}))
    except csv.Error as error:
        problems.add(mapping.file, f"is not a table: {error}", reader.line_num)
        rows = []
    if not rows:
        problems.add(mapping.file, "holds no rows; is the delimiter right?")
    problems.raise_if_any()
    return rows


def _listed(value: Any) -> list[str]:
    return value if isinstance(value, list) else [str(value)]


def _require(mapping: _Mapping, rows: list[tuple[int, dict[str, str]]], columns: list[str], problems: Problems) -> None:
    known = rows[0][1]
    for column in dict.fromkeys(columns):
        if column not in known:
            problems.add(mapping.file, f"has no column '{column}'; {nearest(column, known)}", 1)
    problems.raise_if_any()


def _numbers(
    mapping: _Mapping,
    rows: list[tuple[int, dict[str, str]]],
    columns: list[str],
    problems: Problems,
    gaps: bool = False,
) -> Array:
    """Numbers of some columns, shape (rows, columns); empty cells are NaN where gaps are allowed."""
    values = np.full((len(rows), len(columns)), np.nan)
    for i, (line, row) in enumerate(rows):
        for j, column in enumerate(columns):
            cell = row[column]
            if gaps and (not cell or cell.lower() == "nan"):
                continue
            try:
                values[i, j] = float(cell)
            except ValueError:
                values[i, j] = np.inf
            if not math.isfinite(values[i, j]):
                problems.add(mapping.file, f"{column}: expected a finite number, found '{cell}'", line)
                values[i, j] = 0.0
    values[np.isnan(values).any(axis=1)] = np.nan
    return values


def _steps(
    mapping: _Mapping, rows: list[tuple[int, dict[str, str]]], actions: list[str], problems: Problems
) -> list[int]:
    if "step" not in mapping.columns:
        count: dict[str, int] = {}
        return [count.setdefault(a, 0) + (count.update({a: count[a] + 1}) or 0) for a in actions]
    column = mapping.columns["step"]
    values = _numbers(mapping, rows, [column], problems)[:, 0]
    for (line, _), value in zip(rows, values, strict=True):
        if value < 0 or value != int(value):
            problems.add(mapping.file, f"{column}: expected a whole number from 0, found {value:g}", line)
    return [int(value) for value in values]


def _select(recording: _Recording, frames: tuple[int, int | None, int], source: Path) -> None:
    """Keep every so many frames of each action, and number them from 0."""
    first, last, every = frames
    chosen: list[int] = []
    steps: list[int] = []
    places: dict[str, list[int]] = {}
    for i, action in enumerate(recording.actions):
        places.setdefault(action, []).append(i)
    for action, mine in places.items():
        if any(recording.steps[b] <= recording.steps[a] for a, b in pairwise(mine)):
            raise InputError(f"{source}: the steps of action {action} do not rise: sort the rows, one for each step")
        kept = mine[first : None if last is None else last + 1 : every]
        chosen += kept
        steps += range(len(kept))
    recording.actions = [recording.actions[i] for i in chosen]
    recording.times = [recording.times[i] for i in chosen]
    recording.steps = steps
    recording.positions = {name: values[chosen] for name, values in recording.positions.items()}
    recording.grasps = [recording.grasps[i] for i in chosen] if recording.grasps else []
    recording.translation = None if recording.translation is None else recording.translation[chosen]
    recording.rotation = None if recording.rotation is None else recording.rotation[chosen]


def _to_body_frame(recording: _Recording, mapping: _Mapping) -> None:
    """Rigid motion that takes the markers of `align`, in the first frame, to where they are said to be."""
    if not mapping.align:
        return
    names = [name for name in mapping.align if name in recording.positions]
    here = np.array([recording.positions[name][0] for name in names]).reshape(-1, 3)
    there = np.array([mapping.align[name] for name in names]).reshape(-1, 3)
    if len(names) < 3 or not np.isfinite(here).all():
        raise InputError(f"{mapping.path}: align: its markers must all be seen in the first frame")
    try:
        fit = align(here, there, names)
    except InputError as error:
        raise InputError(f"{mapping.path}: align: {error}") from None
    recording.remarks += fit.remarks
    recording.aligned = fit.rms * mapping.length
    for name, values in recording.positions.items():
        recording.positions[name] = np.clip(values, -_FAR, _FAR) @ fit.turn.T + fit.shift


def _contents(recording: _Recording, mapping: _Mapping) -> Contents:
    names = mapping.fiducials
    frames = list(zip(recording.actions, recording.steps, strict=True))
    starts = {action: time for (action, step), time in zip(frames, recording.times, strict=True) if step == 0}
    times = [(time - starts[a]) * mapping.time for (a, _), time in zip(frames, recording.times, strict=True)]
    positions = np.stack([recording.positions[name] for name in names], axis=1) * mapping.length
    if not np.isfinite(positions).any():
        raise InputError(f"{mapping.file}: no fiducial was seen in any of the chosen frames")
    data = frames_dataset(frames, times, names, positions)
    grasp = str(mapping.table.get("grasp", ""))
    if recording.grasps or grasp:
        data["grasp"] = ("frame", recording.grasps or [grasp] * len(frames))
    if recording.translation is not None:
        data["translation"] = (("frame", "axis"), recording.translation * mapping.length)
    if recording.rotation is not None:
        norms = np.linalg.norm(recording.rotation, axis=1, keepdims=True)
        if (abs(norms - 1) > 1e-3).any():
            raise InputError(f"{mapping.file}: columns.rotation: expected unit quaternions (w, x, y, z)")
        data["rotation"] = (("frame", "quaternion"), recording.rotation / norms)
    sigma = mapping.table.get("noise_sigma")
    description = str(mapping.table.get("description", ""))
    noise = None if sigma is None else sigma * mapping.length
    known = Contents(data.assign_coords(axis=AXES), noise, None, mapping.units, description, str(mapping.path))
    return replace(known, remarks=tuple(recording.remarks), aligned=recording.aligned)
