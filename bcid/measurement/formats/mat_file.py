"""MAT files up to version 7, read by SciPy: ``python -m bcid.measurement.formats.mat_file FILE OUT.npz PATH ...``."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.confined import serve
from bcid.base.unpacked import refuse_large
from bcid.measurement.formats.array_tree import described

# Bytes of a number of MATLAB's classes, and of an entry of any other.
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
_FEWEST = 1
# Structs within structs that are followed.
_DEEPEST = 12


def _arrays(source: Path, wanted: Sequence[str]) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat

    declared = sum(math.prod(shape) * _BYTES.get(kind, _FEWEST) for _, shape, kind in whosmat(str(source)))
    refuse_large(declared, "unpacks to", "keep only what is to be read")
    content = loadmat(str(source))
    tree = {name: _node(value) for name, value in content.items() if not name.startswith("__")}
    return described(tree, list(wanted))


def _node(value: Any, depth: int = 0) -> Any:
    """A variable as dictionaries (structs), lists (cells, struct arrays) and arrays; None for objects of MATLAB classes."""
    from scipy.io.matlab import MatlabObject, MatlabOpaque

    if (
        not isinstance(value, np.ndarray | np.void)
        or isinstance(value, MatlabObject | MatlabOpaque)
        or depth > _DEEPEST
    ):
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


if __name__ == "__main__":
    sys.exit(serve(_arrays, ["scipy.io"]))
