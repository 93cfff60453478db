"""Point clouds and depth images of single frames: ``python -m bcid.measurement.formats.cloud_file FILE OUT.npz NAME ...``.

NAMEs are files in the folder of FILE. Of each the points (n, 3) or the depths (rows, columns), by name, as numbers of the file.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import serve
from bcid.base.errors import InputError
from bcid.base.ply_head import refuse_open_head

Array = NDArray[np.float64]
CLOUDS, DEPTHS = (".ply", ".pcd", ".npy", ".csv", ".xyz", ".txt"), (".png", ".npy")
_PCD_TYPES = {("F", 4): "<f4", ("F", 8): "<f8"} | {
    (kind, size): f"<{letter}{size}" for kind, letter in (("I", "i"), ("U", "u")) for size in (1, 2, 4, 8)
}


def _arrays(source: Path, names: Sequence[str]) -> dict[str, Any]:
    found = {}
    for name in names:
        try:
            found[name] = _read(source.parent / name)
        except Exception as error:
            raise InputError(f"{name}: {error or type(error).__name__}") from None
    return found


def _read(file: Path) -> Array:
    readers: dict[str, Callable[[Path], Any]] = {
        ".ply": _ply,
        ".pcd": _pcd,
        ".npy": partial(np.load, allow_pickle=False),
        ".png": _png,
    }
    return np.asarray(readers.get(file.suffix.lower(), _text)(file), dtype=float)


def _ply(file: Path) -> Any:
    from meshio import ply

    refuse_open_head(file)
    return ply.read(file).points


def _png(file: Path) -> Any:
    import cv2

    image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2:
        raise InputError("is no image with one number per pixel, as depth images are")
    return image


def _text(file: Path) -> Any:
    """Numbers in columns, of which the first three count, below any lines of words."""
    rows = []
    for line in file.read_text(encoding="utf-8-sig").splitlines():
        cells = line.replace(",", " ").replace(";", " ").split()[:3]
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            if rows:
                raise InputError(f"expected numbers, found '{line[:40]}'") from None
            continue
        if len(cells) != 3:
            rows.pop()
            if rows or cells:
                raise InputError(f"expected three numbers in a row, found '{line[:40]}'")
    return np.array(rows, dtype=float).reshape(-1, 3)


def _pcd(file: Path) -> Any:
    """The format of the Point Cloud Library, version 0.7, as text or uncompressed."""
    head: dict[str, list[str]] = {}
    with file.open("rb") as stream:
        while "DATA" not in head:
            line = stream.readline(10_000)
            if not line:
                raise InputError("its header ends without a line DATA")
            words = line.decode("ascii", "replace").split()
            if words and not words[0].startswith("#"):
                head[words[0]] = words[1:]
        fields, sizes, kinds = head["FIELDS"], [int(size) for size in head["SIZE"]], head["TYPE"]
        counts = [int(count) for count in head.get("COUNT", ["1"] * len(fields))]
        if head["DATA"] == ["ascii"]:
            places = np.cumsum([0, *counts])
            return np.loadtxt(stream, ndmin=2)[:, [int(places[fields.index(axis)]) for axis in "xyz"]]
        if head["DATA"] != ["binary"]:
            raise InputError("is compressed; save it as text, or uncompressed")
        columns = zip(range(len(fields)), kinds, sizes, counts, strict=True)
        row = np.dtype([(str(k), _PCD_TYPES[kind, size], (count,)) for k, kind, size, count in columns])
        table = np.frombuffer(stream.read(), row, int(head["POINTS"][0]))
        return np.column_stack([table[str(fields.index(axis))][:, 0] for axis in "xyz"])


if __name__ == "__main__":
    sys.exit(serve(_arrays, ["meshio", "cv2"]))
