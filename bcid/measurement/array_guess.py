"""Which arrays of a MAT or HDF5 file are the markers, their times, names, poses and wrenches, guessed from shapes and names."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError
from bcid.measurement.displacement_guess import guess_displacements
from bcid.measurement.formats.array_file import ArrayFile, look
from bcid.measurement.table_guess import guess_columns

Shape = tuple[int, ...]

# Displacements of Ncorr, and what it says of its grid.
_NCORR = "data_dic_save/displacements/plot_{}_ref_formatted"
_NCORR_GRID = ("data_dic_save/dispinfo/pixtounits", "data_dic_save/dispinfo/spacing")
# Arrays that hold positions are often called so; others with three columns are faces, normals and the like.
_POSITIONS = ("position", "points3d", "xyz", "marker", "point", "traj", "pos", "coord")
_OTHERS = ("face", "normal", "color", "colour", "vector", "disp", "force", "strain", "unit")

_TIMES = ("t", "time", "times", "timestamp", "timestamps")


def guess_arrays(path: Path) -> dict[str, Any]:
    """Keys of a mapping for a MAT, HDF5 or NPZ file.

    Raises:
        InputError: it is damaged, or nothing in it looks like positions; says what is in it.
    """
    content = look(path, list(_NCORR_GRID))
    field = guess_displacements(content)
    tracked = any(len(s) == 3 and 3 in s and _called(p, _POSITIONS) for p, s in content.shapes.items())
    told = _ncorr(content) or field.arrays
    told = told or ({} if field.missing and not tracked else _of_positions(content) or _of_table(content))
    if told:
        return told
    if field.missing:
        raise InputError(
            f"{path}: {field.missing}; add it to the file, or write a mapping with [arrays] (docs/formats.md)"
        )
    shown = ", ".join(f"{p} ({' x '.join(map(str, s)) or 'one number'})" for p, s in list(content.shapes.items())[:40])
    raise InputError(
        f"{path}: no array looks like positions over frames, markers and three axes; it holds {shown or 'nothing'}: "
        'write a mapping with [arrays], as positions = "PATH", or with table = "PATH"'
    )


def _ncorr(content: ArrayFile) -> dict[str, Any]:
    paths = [_NCORR.format(axis) for axis in "uv"]
    if not set(paths) <= set(content.shapes):
        return {}
    scale, spacing = (float(np.ravel(content.arrays.get(key, 1.0))[0]) for key in _NCORR_GRID)
    order = "frame marker" if len(content.shapes[paths[0]]) == 3 else "marker"
    return {"arrays": {"displacements": paths, "grid": scale * (spacing + 1), "order": order}}


def _of_positions(content: ArrayFile) -> dict[str, Any]:
    fit = [p for p, s in content.shapes.items() if len(s) == 3 and 3 in s and p not in content.text]
    if not fit:
        return {}
    best = max(fit, key=lambda p: (_called(p, _POSITIONS), not _called(p, _OTHERS), int(np.prod(content.shapes[p]))))
    shape = content.shapes[best]
    clocks = {max(s): p for p, s in content.shapes.items() if _vector(s) and p.rpartition("/")[2].lower() in _TIMES}
    order = _order(shape, clocks, stacked="Points3D" in best)
    frames, markers = shape[order.index("frame")], shape[order.index("marker")]
    arrays = {"positions": best, "order": " ".join(order)}
    named = next((p for p in content.text if int(np.prod(content.shapes[p])) == markers), None)
    if named is not None:
        arrays["names"] = named
    columns = {"time": clocks[frames]} if frames in clocks else {}
    for key, width, words in (("pose", 7, ("pose",)), ("wrench", 6, ("wrench", "force", "ft"))):
        one = next(
            (p for p, s in content.shapes.items() if sorted(s) == sorted((frames, width)) and _called(p, words)), None
        )
        columns |= {} if one is None else {key: one}
    return {"arrays": arrays, "columns": columns}


def _order(shape: Shape, clocks: dict[int, str], stacked: bool) -> list[str]:
    """Names of the dimensions: the axis has three, the frames as many as there are times, else more than there are markers."""
    axis = max(i for i, n in enumerate(shape) if n == 3)
    left = [i for i in range(3) if i != axis]
    timed = [i for i in left if shape[i] in clocks]
    frame = timed[0] if timed else left[0] if stacked else max(left, key=lambda i: shape[i])
    return ["axis" if i == axis else "frame" if i == frame else "marker" for i in range(3)]


def _of_table(content: ArrayFile) -> dict[str, Any]:
    """A group of vectors whose names are those of coordinates."""
    groups: dict[str, list[str]] = {}
    for path, shape in content.shapes.items():
        if "/" in path and _vector(shape):
            groups.setdefault(path.rpartition("/")[0], []).append(path.rpartition("/")[2])
    for where, names in groups.items():
        told = guess_columns(names)
        if told["fiducials"] or "position" in told["columns"]:
            return told | {"table": where}
    return {}


def _vector(shape: Shape) -> bool:
    return bool(shape) and int(np.prod(shape)) == max(shape) and max(shape) > 1


def _called(path: str, words: Iterable[str]) -> bool:
    return any(word in f"/{path}".lower() for word in words)
