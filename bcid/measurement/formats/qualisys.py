"""TSV exports of Qualisys Track Manager: markers (DATA_INCLUDED 3D) and rigid bodies (6D), in mm.

Source: QTM manual, "TSV file formats": in 6D files each body has X, Y, Z, roll, pitch, yaw, residual and the nine elements of its
rotation matrix, column by column.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bcid.base.errors import InputError
from bcid.measurement.formats.foreign import Export, Foreign, How, Row, whole

Array = NDArray[np.float64]

_BODY = 16


def read(path: Path, _how: How) -> Foreign:
    """The markers, or the rigid bodies, of an export of Qualisys."""
    export = Export.read(path, "\t", "a TSV file of Qualisys")
    rows = export.rows
    start = next((i for i, (_, cells) in enumerate(rows) if _numeric(cells)), len(rows))
    export.need(start + 1)
    about = {cells[0]: (line, cells[1:]) for line, cells in rows[:start]}
    kind = (about.get("DATA_INCLUDED", (0, [""]))[1] or [""])[0]
    key, size = ("BODY_NAMES", _BODY) if kind == "6D" else ("MARKER_NAMES", 3)
    if kind not in ("3D", "6D") or key not in about or "FREQUENCY" not in about:
        rule = "expected DATA_INCLUDED 3D or 6D, names and FREQUENCY"
        raise InputError(f"{path}: {rule}; found '{kind}': export 3D data")
    labels = [name for name in about[key][1] if name]
    export.distinct(labels)
    rate = export.number((about["FREQUENCY"][1] or [""])[0], "FREQUENCY", about["FREQUENCY"][0])
    values = _values(export, rows[start:], size * len(labels))
    if len(values) < (stated := export.number(rows[0][1][1], "NO_OF_FRAMES", 1)):
        raise InputError(f"{path}: states {stated:g} frames and holds {len(values)}: it is cut off; export it again")
    times = np.arange(len(values)) / rate
    parts = {label: values[:, size * i : size * (i + 1)] for i, label in enumerate(labels)}
    if kind == "6D":
        bodies = {label: _pose(part) for label, part in parts.items()}
        return Foreign("TSV of Qualisys (6D)", times, {}, bodies, unit="mm")
    # A marker that was not seen stands at 0, 0, 0.
    lost = {label: (part == 0).all(axis=1, keepdims=True) for label, part in parts.items()}
    points = {label: whole(np.where(lost[label], np.nan, part)) for label, part in parts.items()}
    return Foreign("TSV of Qualisys", times, points, unit="mm")


def _numeric(cells: list[str]) -> bool:
    """Whether a line is one of data: its first cell is a number, or empty."""
    try:
        float(cells[0].replace(",", ".") or "0")
    except ValueError:
        return False
    return True


def _values(export: Export, rows: list[Row], width: int) -> Array:
    """The data without the columns Frame and Time, which stand before them or not."""
    given = len(rows[0][1])
    while given > width + 2 and not any(cells[given - 1] for _, cells in rows if len(cells) >= given):
        given -= 1
    more = 2 if given >= width + 2 else 0
    return export.numbers(rows, width + more)[:, more:]


def _pose(part: Array) -> Array:
    """Position and quaternion (w, x, y, z) of a body, shape (frames, 7)."""
    pose = np.full((len(part), 7), np.nan)
    turn = part[:, 7:].reshape(-1, 3, 3).transpose(0, 2, 1)
    seen = np.isfinite(part[:, :3]).all(axis=1) & np.isfinite(turn).all(axis=(1, 2))
    seen &= np.abs(np.linalg.det(turn) - 1) < 0.01
    pose[seen, :3] = part[seen, :3]
    if seen.any():
        pose[seen, 3:] = Rotation.from_matrix(turn[seen]).as_quat(scalar_first=True)
    return pose
