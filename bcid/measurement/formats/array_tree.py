"""Arrays of MAT, HDF5 and NPZ files, by paths such as ``results/Points3D``, read in a process of its own.

``python -m bcid.measurement.formats.array_tree FILE OUT.npz KIND PATH ...`` is that process, KIND a key of `_READERS`. Python
objects, and links of HDF5 to other files, are refused.
"""

from __future__ import annotations

import math
import sys
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.confined import serve
from bcid.base.own_storage import refuse_outside
from bcid.base.unpacked import refuse_large
from bcid.measurement.formats.foreign import needed

# A tree that is deeper, or has more arrays, is no recording; nor are structs, or references to cells, within as many others.
_DEEPEST, _MOST, _DEEPEST_STRUCT, _DEEPEST_CELL = 16, 5000, 12, 8
# Bytes of a number of MATLAB's classes; an entry of any other has at least one.
_BYTES = {
    "double": 8,
    "int64": 8,
    "uint64": 8,
    "single": 4,
    "int32": 4,
    "uint32": 4,
    "char": 4,
    "int16": 2,
    "uint16": 2,
}
# What MATLAB and pandas keep for themselves in HDF5.
_HIDDEN = ("#refs#", "#subsystem#", "_i_table")
_MOST_CELLS, _MOST_TEXTS = 100_000, 1_000_000


def _arrays(source: Path, arguments: Sequence[str]) -> dict[str, Any]:
    kind, *wanted = arguments
    return _READERS[kind][0](source, wanted)


def leaves(node: Any, path: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Paths and arrays of a tree in which dictionaries are structs, lists are cells and struct arrays.

    Equal fields of a struct array, and cells of one shape, are one array with another dimension in front: a list is yielded.
    """
    if depth > _DEEPEST:
        return
    if isinstance(node, dict):
        for name, part in node.items():
            yield from leaves(part, f"{path}/{name}" if path else name, depth + 1)
    elif isinstance(node, list):
        yield from _listed(node, path, depth)
    elif isinstance(node, str):
        yield path, np.array(node)
    elif hasattr(node, "shape"):
        yield path, node


def _listed(node: list[Any], path: str, depth: int) -> Iterator[tuple[str, Any]]:
    if len(node) == 1:
        yield from leaves(node[0], path, depth + 1)
    elif node and all(isinstance(part, dict) for part in node):
        for name in node[0]:
            yield from leaves([part.get(name) for part in node], f"{path}/{name}", depth + 1)
    elif node and all(hasattr(part, "shape") and part.shape == node[0].shape for part in node):
        yield path, node
    elif node and all(isinstance(part, str) for part in node):
        yield path, np.array(node)


def described(tree: Any, wanted: list[str]) -> dict[str, Any]:
    """What a child gives back: all paths, their shapes, and the wanted arrays as "0", "1", ...

    Raises:
        ValueError: a wanted array holds no numbers and no text.
    """
    found: dict[str, Any] = {}
    for path, leaf in leaves(tree):
        found[path] = leaf
        if len(found) >= _MOST:
            break
    shapes = [(len(leaf), *leaf[0].shape) if isinstance(leaf, list) else leaf.shape for leaf in found.values()]
    texts = [(leaf[0] if isinstance(leaf, list) else leaf).dtype.kind in "USO" for leaf in found.values()]
    made: dict[str, Any] = {"paths": np.array(list(found), dtype=str), "texts": np.array(texts, dtype=bool)}
    made["shapes"] = np.array(["x".join(map(str, shape)) for shape in shapes], dtype=str)
    return made | {str(wanted.index(path)): _loaded(path, found[path]) for path in wanted if path in found}


def _loaded(path: str, leaf: Any) -> Any:
    array = np.stack([np.asarray(part) for part in leaf]) if isinstance(leaf, list) else np.asarray(leaf)
    if array.dtype.kind == "O":
        array = array.astype(str)
    if array.dtype.kind == "S":
        array = np.char.decode(array, "utf-8", "replace")
    if array.dtype.kind not in "biufU":
        raise ValueError(f"{path} holds neither numbers nor text")
    return array if array.dtype.kind == "U" else array.astype(float)


# -- NPZ


def _npz(source: Path, wanted: list[str]) -> dict[str, Any]:
    with zipfile.ZipFile(source) as archive:
        _refuse_large(sum(member.file_size for member in archive.infolist()))
    tree: dict[str, Any] = {}
    with np.load(source, allow_pickle=False) as data:
        for name in data.files:
            *groups, last = name.split("/")
            at = tree
            for group in groups:
                at = at.setdefault(group, {})
                if not isinstance(at, dict):
                    raise ValueError(f"{name} lies in an array")
            at[last] = data[name]
    return described(tree, wanted)


def _refuse_large(declared: int) -> None:
    refuse_large(declared, "unpacks to", "keep only what is to be read")


# -- MAT up to version 7


def _mat(source: Path, wanted: list[str]) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat

    _refuse_large(sum(math.prod(shape) * _BYTES.get(kind, 1) for _, shape, kind in whosmat(str(source))))
    content = loadmat(str(source))
    return described({name: _node(value) for name, value in content.items() if not name.startswith("__")}, wanted)


def _node(value: Any, depth: int = 0) -> Any:
    """A variable as dictionaries (structs), lists (cells, struct arrays) and arrays; None for objects of MATLAB classes."""
    from scipy.io.matlab import MatlabObject, MatlabOpaque

    known = isinstance(value, np.ndarray | np.void) and not isinstance(value, MatlabObject | MatlabOpaque)
    if not known or depth > _DEEPEST_STRUCT:
        return None
    if value.dtype.names:
        parts = np.ravel(value)
        made = [{name: _node(part[name], depth + 1) for name in value.dtype.names} for part in parts]
        return made[0] if len(made) == 1 else made
    if value.dtype.kind == "O":
        return [_node(part, depth + 1) for part in np.ravel(value, order="F")]
    if value.dtype.kind == "U":
        return str(value.ravel()[0]) if value.size == 1 else np.char.strip(np.asarray(value))
    return value


# -- HDF5, and with it MAT of version 7.3


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


def _hdf5(source: Path, wanted: list[str]) -> dict[str, Any]:
    try:
        import h5py
    except ImportError:
        raise needed("h5py") from None
    with h5py.File(source, "r") as file:
        refuse_outside(file)
        made = described(_group(file, file, set()), wanted)
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

    if not isinstance(data, h5py.Dataset) or depth > _DEEPEST_CELL or data.shape is None:
        return None
    kind = data.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else ""
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


# The reader of each kind, and the library that it is imported with before rights are given up.
_READERS: dict[str, tuple[Callable[[Path, list[str]], dict[str, Any]], str]] = {
    "MAT": (_mat, "scipy.io"),
    "HDF5": (_hdf5, "h5py"),
    "NPZ": (_npz, "numpy"),
}

if __name__ == "__main__":
    sys.exit(serve(_arrays, [_READERS[sys.argv[3]][1]]))
