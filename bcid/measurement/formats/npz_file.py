"""NPZ archives of NumPy: ``python -m bcid.measurement.formats.npz_file FILE OUT.npz PATH ...``. Python objects are refused."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.confined import serve
from bcid.base.unpacked import refuse_large
from bcid.measurement.formats.array_tree import described


def _arrays(source: Path, wanted: Sequence[str]) -> dict[str, Any]:
    import zipfile

    with zipfile.ZipFile(source) as archive:
        declared = sum(member.file_size for member in archive.infolist())
    refuse_large(declared, "unpacks to", "keep only what is to be read")
    with np.load(source, allow_pickle=False) as data:
        return described(_tree({name: data[name] for name in data.files}), list(wanted))


def _tree(arrays: dict[str, Any]) -> dict[str, Any]:
    """Arrays in groups, by the slashes in their names."""
    made: dict[str, Any] = {}
    for name, array in arrays.items():
        *groups, last = name.split("/")
        at = made
        for group in groups:
            at = at.setdefault(group, {})
            if not isinstance(at, dict):
                raise ValueError(f"{name} lies in an array")
        at[last] = array
    return made


if __name__ == "__main__":
    sys.exit(serve(_arrays, ["numpy"]))
