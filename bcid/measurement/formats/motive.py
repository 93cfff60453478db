"""CSV exports of OptiTrack Motive: rigid bodies and markers.

Source: OptiTrack documentation, "Data Export: CSV" (format versions 1.2 and newer).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.measurement.formats.foreign import Foreign, How
from bcid.measurement.formats.grid import Row, filled, need, numbers, read_grid, whole

Array = NDArray[np.float64]

_UNITS = {"meters": "m", "centimeters": "cm", "millimeters": "mm", "inches": "in"}
_MARKERS = ("Marker", "Rigid Body Marker", "Bone Marker")


def recognised(head: str) -> bool:
    """Whether text begins as an export of Motive does."""
    return head.startswith("Format Version,")


def read(path: Path, _how: How) -> Foreign:
    """The markers and rigid bodies of an export of Motive.

    Raises:
        InputError: it is cut off, or its numbers are none.
    """
    rows = filled(read_grid(path, ","))
    first = rows[0][1]
    about = dict(zip(first[::2], first[1::2], strict=False))
    start = next((i for i, (_, cells) in enumerate(rows) if cells[0] == "Frame"), len(rows))
    need(path, rows, start + 1, "a CSV file of Motive")
    types, names = _header(path, rows[1:start], "Type"), _header(path, rows[1:start], "Name")
    kinds, axes = rows[start - 1][1], rows[start][1]
    columns: dict[tuple[str, str, str], dict[str, int]] = {}
    for i, axis in enumerate(axes[2:], 2):
        if axis:
            columns.setdefault((_at(types, i), _at(names, i), _at(kinds, i)), {})[axis] = i
    values = numbers(path, rows[start + 1 :], len(axes), "a CSV file of Motive")
    points = {
        name: whole(values[:, [at[a] for a in "XYZ"]])
        for (of, name, kind), at in columns.items()
        if of in _MARKERS and kind == "Position" and set("XYZ") <= set(at)
    }
    bodies = _bodies(columns, values)
    left = sorted({name for of, name, kind in columns if of == "Rigid Body" and name not in bodies})
    notes = tuple(f"rotations of {name} are no quaternions: export them as such" for name in left)
    unit = _UNITS.get(about.get("Length Units", "").lower(), "")
    return Foreign("CSV of OptiTrack Motive", values[:, 1], points, bodies, unit=unit, notes=notes)


def _header(path: Path, rows: list[Row], name: str) -> list[str]:
    """The line of the header that begins with a word, which older versions leave out in favour of the order."""
    for _, cells in rows:
        if name in cells[:2]:
            return cells
    raise InputError(f"{path}: its header has no line '{name}'; export it from Motive with all header lines")


def _at(cells: list[str], i: int) -> str:
    return cells[i] if i < len(cells) else ""


def _bodies(columns: dict[tuple[str, str, str], dict[str, int]], values: Array) -> dict[str, Array]:
    """Poses of the rigid bodies whose rotations are quaternions."""
    found = {}
    for (of, name, kind), at in columns.items():
        turn = columns.get((of, name, "Rotation"), {})
        if of == "Rigid Body" and kind == "Position" and set("XYZW") <= set(turn):
            found[name] = values[:, [*(at[a] for a in "XYZ"), *(turn[a] for a in "WXYZ")]]
    return found
