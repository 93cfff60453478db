"""What OpenCV's FileStorage wrote: YAML, XML or JSON, read by OpenCV in a process of its own, which nested brackets can end.

``python -m bcid.vision.calibrations.opencv_storage FILE OUT.npz`` is that process.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.confined import read_in_child, serve
from bcid.base.errors import InputError
from bcid.base.text_file import read_text

_SECONDS = 30.0


def opencv_values(path: Path) -> dict[str, Any]:
    """The content by name: numbers, texts, lists of them, and matrices.

    Raises:
        InputError: OpenCV cannot read it, or dies of it.
    """
    try:
        data = read_in_child("bcid.vision.calibrations.opencv_storage", path, seconds=_SECONDS)
    except (InputError, TimeoutError) as error:
        raise InputError(f"{path}: OpenCV cannot read it: {error}") from None
    values: dict[str, Any] = json.loads(str(data["plain"]))
    return values | {str(name): data[f"matrix{i}"] for i, name in enumerate(data["matrices"])}


def _values(source: Path, _arguments: Sequence[str]) -> dict[str, Any]:
    import cv2

    # The text is handed over, so that no other file is opened.
    try:
        storage = cv2.FileStorage(read_text(source), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        values = {name: _node(root.getNode(name)) for name in root.keys()}  # noqa: SIM118 (a FileNode is no dict)
    except (cv2.error, SystemError) as error:
        raise InputError(str(error).splitlines()[0]) from None
    matrices = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    plain = {name: value for name, value in values.items() if name not in matrices}
    made = {f"matrix{i}": matrix for i, matrix in enumerate(matrices.values())}
    # A matrix within a list is none that a calibration has.
    text = json.dumps(plain, default=np.ndarray.tolist)
    return made | {"matrices": np.array(list(matrices), dtype=str), "plain": np.array(text)}


def _node(node: Any) -> Any:
    if node.isInt() or node.isReal():
        return node.real()
    if node.isString():
        return node.string()
    if node.isSeq():
        return [_node(node.at(i)) for i in range(node.size())]
    return node.mat()


if __name__ == "__main__":
    sys.exit(serve(_values, ["cv2"]))
