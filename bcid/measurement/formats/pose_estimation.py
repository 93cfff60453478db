"""Tables of DeepLabCut (CSV and HDF5) and Anipose, triangulated: markers in 3-D with how sure each position is.

Sources: DeepLabCut documentation, "3D DeepLabCut"; Anipose documentation, "Triangulation". HDF5 is read in a process of its own,
``python -m bcid.measurement.formats.pose_estimation FILE OUT.npz``, by h5py: pandas and PyTables would unpickle what a file holds
as Python objects, which can run anything. Read are the layouts "table" (a compound array; labels as pickled literals) and "fixed"
(blocks of numbers; labels as byte strings with codes).
"""

from __future__ import annotations

import io
import pickle
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import serve
from bcid.base.errors import InputError
from bcid.base.own_storage import refuse_outside
from bcid.measurement.formats.foreign import Export, Foreign, How, fetched, needed, whole

Array = NDArray[np.float64]

# What the columns of a marker besides x, y, z say.
_QUALITY = {"likelihood": "score", "score": "score", "error": "error", "ncams": "cameras"}
_ANIPOSE = re.compile(r"(?P<label>.+)_(?P<what>x|y|z|error|ncams|score)")
# Bytes of a list of names at most.
_LONGEST = 1_000_000
_CSV = "export it as CSV (deeplabcut.analyze_videos_converth5_to_csv, or to_csv of pandas)"


def recognised_anipose(head: str) -> bool:
    """Whether text begins as a 3-D file of Anipose does."""
    names = head.splitlines()[0].split(",") if head else []
    return {"x", "y", "z", "ncams"} <= {m["what"] for m in map(_ANIPOSE.fullmatch, names) if m}


def read_dlc(path: Path, how: How) -> Foreign:
    """The body parts of a CSV file of DeepLabCut, by their names; of several individuals as "individual/part".

    Raises:
        InputError: it is two-dimensional, cut off, or its numbers are none.
    """
    export = Export.read(path, ",", "a CSV file of DeepLabCut")
    rows = export.rows
    start = next((i for i, (_, cells) in enumerate(rows) if cells[0].isascii() and cells[0].isdigit()), len(rows))
    export.need(start + 1)
    names = {cells[0]: cells[1:] for _, cells in rows[:start]}
    values = export.numbers(rows[start:], len(rows[0][1]))[:, 1:]
    return _dlc(path, names, values, how)


def read_dlc_hdf5(path: Path, how: How) -> Foreign:
    """The same of the HDF5 file that DeepLabCut writes."""
    data = fetched("bcid.measurement.formats.pose_estimation", path, "HDF5 file of DeepLabCut")
    names = {str(level): [str(name) for name in row] for level, row in zip(data["levels"], data["names"], strict=True)}
    return _dlc(path, names, data["values"], how)


def read_anipose(path: Path, how: How) -> Foreign:
    """The markers of a 3-D file of Anipose."""
    export = Export.read(path, ",", "a 3-D file of Anipose")
    header = export.rows[0][1]
    values = export.numbers(export.rows[1:], len(header))
    columns: dict[str, dict[str, Array]] = {}
    for i, match in enumerate(map(_ANIPOSE.fullmatch, header)):
        if match:
            columns.setdefault(match["label"], {})[match["what"]] = values[:, i]
    # Offset and axes of the frame, M_00 ... and center_0 ..., are no markers.
    return _foreign("3-D CSV of Anipose", {label: at for label, at in columns.items() if set("xyz") <= set(at)}, how)


def _dlc(path: Path, names: dict[str, list[str]], values: Array, how: How) -> Foreign:
    if not {"bodyparts", "coords"} <= set(names):
        raise InputError(f"{path}: names {', '.join(names)}; a table of DeepLabCut has bodyparts and coords")
    for level, row in names.items():
        if len(row) != values.shape[1]:
            said = f"its line '{level[:40]}' names {len(row)} columns, its numbers have {values.shape[1]}"
            raise InputError(f"{path}: {said}; export it again")
    if "z" not in names["coords"]:
        rule = "triangulate it first (deeplabcut.triangulate)"
        raise InputError(f"{path}: holds positions in an image (x, y) alone; {rule}")
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


def _table(source: Path, _arguments: Sequence[str]) -> dict[str, Any]:
    try:
        import h5py
    except ImportError:
        raise needed("h5py") from None
    with h5py.File(source, "r") as file:
        refuse_outside(file)
        groups = [part for part in file.values() if isinstance(part, h5py.Group) and "pandas_type" in part.attrs]
        if len(groups) != 1:
            raise InputError(f"it holds {len(groups)} tables of pandas, not one; {_CSV}")
        kind = _text(groups[0].attrs["pandas_type"])
        if kind not in ("frame", "frame_table"):
            raise InputError(f"it holds a '{kind[:40]}' of pandas, not a table; {_CSV}")
        try:
            levels, names, values = (_fixed if kind == "frame" else _appendable)(groups[0])
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise InputError(f"it is not laid out as pandas does it ({error or 'no reason'}); {_CSV}"[:280]) from None
    if len(levels) < 2:
        raise InputError("its table has one line of names; one of DeepLabCut has scorer, bodyparts and coords")
    return {"levels": np.array(levels, dtype=str), "names": np.array(names, dtype=str).T, "values": values}


def _appendable(group: Any) -> tuple[list[str], list[tuple[str, ...]], Array]:
    """Levels, names (columns, levels) and values (rows, columns) of the layout "table"."""
    table = group["table"]
    levels = [str(name) for name in _literal(group.attrs["info"])[1].get("names", [])]
    blocks = [name for name in table.dtype.names or () if name.startswith("values_block_")]
    if not levels or not blocks:
        raise InputError(f"it is no table whose columns have several lines of names; {_CSV}")
    names, values = [], []
    for block in blocks:
        labels = [tuple(map(str, label)) for label in _literal(table.attrs[f"{block}_kind"])]
        numbers = _numbers(table[block], block).reshape(len(table), -1)
        _matching(labels, levels, numbers)
        names += labels
        values.append(numbers)
    return levels, names, np.hstack(values)


def _fixed(group: Any) -> tuple[list[str], list[tuple[str, ...]], Array]:
    """The same of the layout "fixed"."""
    count = int(group.attrs["nblocks"])
    levels: list[str] = []
    names, values = [], []
    for block in range(count):
        levels, labels = _labels(group, f"block{block}_items")
        data = group[f"block{block}_values"]
        numbers = _numbers(data, f"block{block}_values")
        numbers = numbers if data.attrs.get("transposed", 0) else numbers.T
        _matching(labels, levels, numbers)
        names += labels
        values.append(numbers)
    if not values:
        raise InputError("its table has no columns")
    return levels, names, np.hstack(values)


def _labels(group: Any, axis: str) -> tuple[list[str], list[tuple[str, ...]]]:
    """Names of the levels of an axis, and the labels along it, from the values of each level and codes into them."""
    if _text(group.attrs[f"{axis}_variety"]) != "multi":
        return [axis], []
    columns, levels = [], []
    for number in range(int(group.attrs[f"{axis}_nlevels"])):
        level, codes = group[f"{axis}_level{number}"], np.asarray(group[f"{axis}_label{number}"])
        known = _strings(level, f"{axis}_level{number}")
        if codes.dtype.kind not in "iu" or codes.ndim != 1 or ((codes < 0) | (codes >= len(known))).any():
            raise InputError(f"the codes of {axis}_label{number} lead outside of the names")
        levels.append(_text(level.attrs.get("name", b"")))
        columns.append([known[code] for code in codes])
    return levels, list(zip(*columns, strict=True))


def _strings(level: Any, name: str) -> list[str]:
    if "PSEUDOATOM" in level.attrs or level.dtype.kind not in "Siu" or level.ndim != 1:
        raise InputError(f"its names ({name}) are kept as Python objects, which are not read; {_CSV}")
    return [value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value) for value in np.asarray(level)]


def _numbers(data: Any, name: str) -> Array:
    if "PSEUDOATOM" in getattr(data, "attrs", ()) or data.dtype.kind not in "fiu":
        raise InputError(f"its values ({name}) are kept as Python objects or text, which are not read; {_CSV}")
    if data.ndim not in (1, 2):
        raise InputError(f"its values ({name}) have {data.ndim} dimensions; a table has 2")
    return np.asarray(data, dtype=float)


def _matching(labels: list[tuple[str, ...]], levels: list[str], numbers: Array) -> None:
    if numbers.ndim != 2 or numbers.shape[1] != len(labels) or any(len(label) != len(levels) for label in labels):
        raise InputError(f"its {numbers.shape[-1]} columns have {len(labels)} labels, or not one for each of {levels}")


class _Literals(pickle.Unpickler):
    """Makes literals alone: all other objects of a pickle have a name (Python library reference, "Restricting Globals")."""

    def find_class(self, module: str, name: str) -> Any:
        raise InputError(f"holds a Python object ({f'{module}.{name}'[:60]}), which is not made")


def _literal(pickled: Any) -> Any:
    if len(pickled) > _LONGEST:
        raise InputError(f"a list of its names is longer than labels are; {_CSV}")
    try:
        return _Literals(io.BytesIO(bytes(pickled))).load()
    except Exception as error:
        # Whatever a damaged pickle lets the interpreter raise.
        reason = str(error) if isinstance(error, InputError) else "is damaged"
        raise InputError(f"a list of its names {reason}; {_CSV}") from None


def _text(value: Any) -> str:
    return bytes(value).decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


if __name__ == "__main__":
    sys.exit(serve(_table, ["h5py"]))
