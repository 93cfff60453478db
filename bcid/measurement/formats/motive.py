"""CSV exports of OptiTrack Motive: rigid bodies and markers.

Source: OptiTrack documentation, "Data Export: CSV" (format versions 1.2 and newer).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.measurement.formats.foreign import Export, Foreign, How, Row, length_unit, whole

Array = NDArray[np.float64]

# Type, name and kind of columns, and which column holds which axis.
Columns = dict[tuple[str, str, str], dict[str, int]]

# What was measured comes first: the others are where a marker of the solved body or skeleton would be.
_MARKERS = ("Marker", "Rigid Body Marker", "Bone Marker")
_TYPES = {*_MARKERS, "Rigid Body", "Bone"}


def read(path: Path, _how: How) -> Foreign:
    """The markers and rigid bodies of an export of Motive."""
    export = Export.read(path, ",", "a CSV file of Motive")
    rows = export.rows
    first = rows[0][1]
    about = dict(zip(first[::2], first[1::2], strict=False))
    start = next((i for i, (_, cells) in enumerate(rows) if cells[0] == "Frame"), len(rows))
    export.need(start + 1)
    types, names = _header(path, rows[1:start])
    axes = rows[start][1]
    columns = _columns(types, names, rows[start - 1][1], axes)
    # Others hold text: the time code.
    used = {1, *(i for at in columns.values() for i in at.values())}
    values = export.numbers(rows[start + 1 :], len(axes), used)
    bodies = _bodies(columns, values)
    left = sorted({name for of, name, kind in columns if of == "Rigid Body" and name not in bodies})
    notes = [f"rotations of {name} are no quaternions: export them as such" for name in left]
    if about.get("Coordinate Space") == "Local":
        notes.append("positions are relative to their parents (Coordinate Space Local): export them as Global")
    unit = length_unit(about.get("Length Units", ""))
    points = _points(columns, values)
    return Foreign("CSV of OptiTrack Motive", values[:, 1], points, bodies, unit=unit, notes=tuple(notes))


def _header(path: Path, rows: list[Row]) -> tuple[list[str], list[str]]:
    """The lines of types and of names, which begin with these words; older versions leave the words out and have them first."""
    named = {word: cells for _, cells in rows for word in ("Type", "Name") if word in cells[:2]}
    if len(named) == 2:
        return named["Type"], named["Name"]
    if not named and len(rows) > 2 and _TYPES & set(rows[0][1]):
        return rows[0][1], rows[1][1]
    lost = next(word for word in ("Type", "Name") if word not in named)
    raise InputError(f"{path}: its header has no line '{lost}'; export it from Motive with all header lines")


def _columns(types: list[str], names: list[str], kinds: list[str], axes: list[str]) -> Columns:
    """The columns of positions and rotations; of several with one type and name the later ones are called "name (2)" and so on."""
    found: Columns = {}
    for i, axis in enumerate(axes[2:], 2):
        of, name, kind = (cells[i] if i < len(cells) else "" for cells in (types, names, kinds))
        if axis not in ("X", "Y", "Z", "W") or kind not in ("Position", "Rotation"):
            continue
        count, label = 1, name
        while axis in found.get((of, label, kind), {}):
            count += 1
            label = f"{name} ({count})"
        found.setdefault((of, label, kind), {})[axis] = i
    return found


def _points(columns: Columns, values: Array) -> dict[str, Array]:
    """Positions of the markers, each as it was measured if the file has that."""
    chosen: dict[str, tuple[int, dict[str, int]]] = {}
    for (of, name, kind), at in columns.items():
        if of in _MARKERS and kind == "Position" and set("XYZ") <= set(at):
            known = chosen.get(name, (len(_MARKERS), at))
            chosen[name] = min(known, (_MARKERS.index(of), at), key=lambda one: one[0])
    return {name: whole(values[:, [at[a] for a in "XYZ"]]) for name, (_, at) in chosen.items()}


def _bodies(columns: Columns, values: Array) -> dict[str, Array]:
    """Poses of the rigid bodies whose rotations are quaternions."""
    found = {}
    for (of, name, kind), at in columns.items():
        turn = columns.get((of, name, "Rotation"), {})
        if of == "Rigid Body" and kind == "Position" and set("XYZ") <= set(at) and set("XYZW") <= set(turn):
            found[name] = values[:, [*(at[a] for a in "XYZ"), *(turn[a] for a in "WXYZ")]]
    return found
