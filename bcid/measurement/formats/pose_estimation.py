"""Tables of DeepLabCut (CSV and HDF5) and Anipose, triangulated: markers in 3-D with how sure each position is.

Sources: DeepLabCut documentation, "3D DeepLabCut"; Anipose documentation, "Triangulation".
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.measurement.formats.foreign import Foreign, How, fetched
from bcid.measurement.formats.grid import Row, filled, need, numbers, read_grid, whole

Array = NDArray[np.float64]

# What the columns of a marker besides x, y, z say.
_QUALITY = {"likelihood": "score", "score": "score", "error": "error", "ncams": "cameras"}
_ANIPOSE = re.compile(r"(?P<label>.+)_(?P<what>x|y|z|error|ncams|score)")


def recognised_anipose(head: str) -> bool:
    """Whether text begins as a 3-D file of Anipose does."""
    names = head.splitlines()[0].split(",") if head else []
    return {"x", "y", "z", "ncams"} <= {m["what"] for m in map(_ANIPOSE.fullmatch, names) if m}


def read_dlc(path: Path, how: How) -> Foreign:
    """The body parts of a CSV file of DeepLabCut, by their names; of several individuals as "individual/part".

    Raises:
        InputError: it is two-dimensional, cut off, or its numbers are none.
    """
    rows = filled(read_grid(path, ","))
    start = next((i for i, (_, cells) in enumerate(rows) if _whole_number(cells[0])), len(rows))
    need(path, rows, start + 1, "a CSV file of DeepLabCut")
    names = {cells[0]: cells[1:] for _, cells in rows[:start]}
    values = numbers(path, rows[start:], len(rows[0][1]), "a CSV file of DeepLabCut")[:, 1:]
    return _dlc(path, names, values, how)


def read_dlc_hdf5(path: Path, how: How) -> Foreign:
    """The same of the HDF5 file that DeepLabCut writes."""
    data = fetched("bcid.measurement.formats.pandas_table", path, "HDF5 file of DeepLabCut")
    names = {str(level): [str(name) for name in row] for level, row in zip(data["levels"], data["names"], strict=True)}
    return _dlc(path, names, data["values"], how)


def read_anipose(path: Path, how: How) -> Foreign:
    """The markers of a 3-D file of Anipose."""
    rows: list[Row] = filled(read_grid(path, ","))
    header = rows[0][1]
    values = numbers(path, rows[1:], len(header), "a 3-D file of Anipose")
    columns: dict[str, dict[str, Array]] = {}
    for i, match in enumerate(map(_ANIPOSE.fullmatch, header)):
        if match:
            columns.setdefault(match["label"], {})[match["what"]] = values[:, i]
    # Offset and axes of the frame, M_00 ... and center_0 ..., are no markers.
    return _foreign("3-D CSV of Anipose", {label: at for label, at in columns.items() if set("xyz") <= set(at)}, how)


def _whole_number(text: str) -> bool:
    return text.isascii() and text.isdigit()


def _dlc(path: Path, names: dict[str, list[str]], values: Array, how: How) -> Foreign:
    if not {"bodyparts", "coords"} <= set(names):
        raise InputError(f"{path}: names {', '.join(names)}; a table of DeepLabCut has bodyparts and coords")
    for level, row in names.items():
        if len(row) != values.shape[1]:
            said = f"its line '{level[:40]}' names {len(row)} columns, its numbers have {values.shape[1]}"
            raise InputError(f"{path}: {said}; export it again")
    if "z" not in names["coords"]:
        raise InputError(
            f"{path}: holds positions in an image (x, y) alone; triangulate it first (deeplabcut.triangulate)"
        )
    parts, one = names["bodyparts"], names.get("individuals")
    labels = parts if one is None else [f"{who}/{part}" for who, part in zip(one, parts, strict=True)]
    columns: dict[str, dict[str, Array]] = {}
    for i, (label, what) in enumerate(zip(labels, names["coords"], strict=True)):
        columns.setdefault(label, {})[what] = values[:, i]
    for label, at in columns.items():
        if missing := sorted(set("xyz") - set(at)):
            raise InputError(f"{path}: {label} has no column '{missing[0]}'; export it again")
    return _foreign("DeepLabCut", columns, how)


def _foreign(name: str, columns: dict[str, dict[str, Array]], how: How) -> Foreign:
    points = {label: whole(np.stack([at[axis] for axis in "xyz"], axis=1)) for label, at in columns.items()}
    quality: dict[str, dict[str, Array]] = {}
    for label, at in columns.items():
        for what, kind in _QUALITY.items():
            if what in at:
                quality.setdefault(kind, {})[label] = at[what]
    times = how.count(len(next(iter(points.values()))))
    return Foreign(name, times, points, quality=quality, clocked=how.rate is not None)
