"""Tables with a header line: one row per frame, or one per frame and fiducial, as a mapping names their columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems, nearest
from bcid.measurement.csv_rows import Row, csv_rows, numbers, require
from bcid.measurement.formats.array_file import table_rows
from bcid.measurement.mapping import COLUMNS, Mapping
from bcid.measurement.tracks import Tracks

Array = NDArray[np.float64]


def read_table(mapping: Mapping) -> Tracks:
    """The tracks in a table, in its own units.

    Raises:
        InputError: with every problem of the table.
    """
    rows = _rows(mapping)
    if "fiducial" in mapping.columns:
        return _long(mapping, rows)
    columns = mapping.columns
    problems = Problems(f"recording {mapping.file}")
    wanted = [c for marker in mapping.markers.values() for c in marker]
    wanted += [c for key in COLUMNS if key in columns for c in _listed(columns[key])]
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
    moved = _gripper(mapping, rows, problems)
    problems.raise_if_any()
    grasps = [row[columns["grasp"]] for _, row in rows] if "grasp" in columns else []
    return Tracks(actions, steps, list(times), positions, *moved, grasps)


def _long(mapping: Mapping, rows: list[Row]) -> Tracks:
    """One row per frame and fiducial."""
    columns = mapping.columns
    problems = Problems(f"recording {mapping.file}")
    for key in ("position", "step"):
        if key not in columns:
            problems.add(mapping.path, f"columns.{key}: is needed when columns.fiducial is given")
    problems.raise_if_any()
    _require(mapping, rows, [c for key in COLUMNS if key in columns for c in _listed(columns[key])], problems)
    action = str(mapping.table.get("action", "1"))
    actions = [row[columns["action"]] if "action" in columns else action for _, row in rows]
    steps = _steps(mapping, rows, actions, problems)
    values = _numbers(mapping, rows, columns["position"], problems, gaps=True)
    times = (
        _numbers(mapping, rows, [columns["time"]], problems)[:, 0]
        if "time" in columns
        else np.array(steps, dtype=float)
    )
    moved = _gripper(mapping, rows, problems)
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
    translation, rotation, pose, wrench = (None if values is None else values[chosen] for values in moved)
    return Tracks(
        [f[0] for f in frames],
        [f[1] for f in frames],
        list(times[chosen]),
        positions,
        translation,
        rotation,
        pose,
        wrench,
        grasps,
    )


def _gripper(
    mapping: Mapping, rows: list[Row], problems: Problems
) -> tuple[Array | None, Array | None, Array | None, Array | None]:
    """Translation, rotation, pose and wrench of the gripper, where columns are named for them; the wrench may have gaps."""

    def read(key: str) -> Array | None:
        columns = mapping.columns.get(key)
        return None if columns is None else _numbers(mapping, rows, columns, problems, gaps=key == "wrench")

    return read("translation"), read("rotation"), read("pose"), read("wrench")


def _rows(mapping: Mapping) -> list[Row]:
    if "table" in mapping.table:
        names, cells = table_rows(mapping.file, str(mapping.table["table"]))
        return [(i, dict(zip(names, row, strict=True))) for i, row in enumerate(cells, 1)]
    return csv_rows(mapping.file, str(mapping.table.get("delimiter", ",")))


def _listed(value: Any) -> list[str]:
    return value if isinstance(value, list) else [str(value)]


def _require(mapping: Mapping, rows: list[Row], columns: list[str], problems: Problems) -> None:
    require(mapping.file, rows, columns, problems)


def _numbers(mapping: Mapping, rows: list[Row], columns: list[str], problems: Problems, gaps: bool = False) -> Array:
    return numbers(mapping.file, rows, columns, str(mapping.table.get("decimal", ".")), problems, gaps)


def _steps(mapping: Mapping, rows: list[Row], actions: list[str], problems: Problems) -> list[int]:
    if "step" not in mapping.columns:
        count: dict[str, int] = {}
        return [count.setdefault(a, 0) + (count.update({a: count[a] + 1}) or 0) for a in actions]
    column = mapping.columns["step"]
    values = _numbers(mapping, rows, [column], problems)[:, 0]
    for (line, _), value in zip(rows, values, strict=True):
        if value < 0 or value != int(value):
            problems.add(mapping.file, f"{column}: expected a whole number from 0, found {value:g}", line)
    return [int(value) for value in values]
