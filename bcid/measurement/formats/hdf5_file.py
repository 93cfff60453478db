"""HDF5 files, MAT files of version 7.3 among them, read by h5py in a process of its own.

``python -m bcid.measurement.formats.hdf5_file FILE OUT.npz PATH ...`` is that process. Links to other files are refused.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.confined import serve
from bcid.base.own_storage import refuse_outside
from bcid.measurement.formats.array_tree import described
from bcid.measurement.formats.in_child import needed

# What MATLAB and pandas keep for themselves.
_HIDDEN = ("#refs#", "#subsystem#", "_i_table")
_MOST_CELLS, _MOST_TEXTS = 100_000, 1_000_000


class _Field:
    """A column of a table, as an array that is read when it is asked for."""

    def __init__(self, table: Any, name: str) -> None:
        self.table, self.name = table, name
        self.dtype = table.dtype[name].base
        self.shape = table.shape + table.dtype[name].shape

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.table[self.name], dtype=dtype)


class _Matlab:
    """A numeric array of MATLAB, whose dimensions stand the other way round in the file."""

    def __init__(self, data: Any) -> None:
        self.data, self.dtype, self.shape = data, data.dtype, data.shape[::-1]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.data[()], dtype=dtype).T


def _arrays(source: Path, wanted: Sequence[str]) -> dict[str, Any]:
    try:
        import h5py
    except ImportError:
        raise needed("h5py") from None
    with h5py.File(source, "r") as file:
        refuse_outside(file)
        made = described(_group(file, file, set()), list(wanted))
        made["pandas"] = any("pandas_type" in part.attrs for part in file.values() if isinstance(part, h5py.Group))
    return made


def _group(file: Any, group: Any, seen: set[Any]) -> dict[str, Any]:
    """The arrays of a group and of those in it, each group once: links may go in circles."""
    import h5py

    place = h5py.h5o.get_info(group.id).addr
    if place in seen:
        return {}
    seen.add(place)
    made: dict[str, Any] = {}
    for name in group:
        if name not in _HIDDEN and isinstance(group.get(name, getlink=True), h5py.HardLink):
            part = group[name]
            made[name] = _group(file, part, seen) if isinstance(part, h5py.Group) else _data(file, part)
    return made


def _data(file: Any, data: Any, depth: int = 0) -> Any:
    import h5py

    if not isinstance(data, h5py.Dataset) or depth > 8 or data.shape is None:
        return None
    kind = data.attrs.get("MATLAB_class", b"").decode() if isinstance(data.attrs.get("MATLAB_class"), bytes) else ""
    # Text and references are read at once, one by one, and more are no names.
    if (kind == "char" or data.dtype.kind in "OS") and data.size > _MOST_TEXTS:
        return None
    if h5py.check_ref_dtype(data.dtype) is not None:
        references = np.asarray(data[()]).ravel()[:_MOST_CELLS]
        return [_referred(file, reference, depth) for reference in references]
    if data.dtype.names:
        return {name: _Field(data, name) for name in data.dtype.names}
    if kind == "char":
        return "".join(chr(int(code)) for code in np.asarray(data[()]).ravel())
    if h5py.check_string_dtype(data.dtype) is not None:
        return np.asarray(data.asstr()[()]).astype(str)
    return _Matlab(data) if kind else data


def _referred(file: Any, reference: Any, depth: int) -> Any:
    """What a cell of MATLAB holds."""
    import h5py

    if not reference:
        return None
    part = file[reference]
    return _group(file, part, set()) if isinstance(part, h5py.Group) else _data(file, part, depth + 1)


if __name__ == "__main__":
    sys.exit(serve(_arrays, ["h5py"]))
