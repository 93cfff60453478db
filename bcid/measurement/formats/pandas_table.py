"""Tables that pandas wrote to HDF5, read by h5py: ``python -m bcid.measurement.formats.pandas_table FILE OUT.npz``.

pandas and PyTables would unpickle what a file holds as Python objects, which can run anything. Read are the layouts that DeepLabCut
writes: "table" (a compound array; labels as pickled literals) and "fixed" (blocks of numbers; labels as byte strings with codes).
"""

from __future__ import annotations

import io
import pickle
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import serve
from bcid.base.errors import InputError
from bcid.base.own_storage import refuse_outside
from bcid.measurement.formats.foreign import needed

Array = NDArray[np.float64]
# Bytes of a list of names at most.
_LONGEST = 1_000_000
_CSV = "export it as CSV (deeplabcut.analyze_videos_converth5_to_csv, or to_csv of pandas)"


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
