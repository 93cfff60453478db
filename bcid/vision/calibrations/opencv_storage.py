"""What OpenCV's FileStorage wrote: YAML, XML or JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bcid.base.errors import InputError


def opencv_values(path: Path, text: str) -> dict[str, Any]:
    """The content by name; the text is handed over, so that no other file is opened.

    Raises:
        InputError: OpenCV cannot read it.
    """
    import cv2

    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        return {name: _node(root.getNode(name)) for name in root.keys()}  # noqa: SIM118 (a FileNode is no dict)
    except (cv2.error, SystemError) as error:
        raise InputError(f"{path}: OpenCV cannot read it: {str(error).splitlines()[0]}") from None


def _node(node: Any) -> Any:
    if node.isInt() or node.isReal():
        return node.real()
    if node.isString():
        return node.string()
    if node.isSeq():
        return [_node(node.at(i)) for i in range(node.size())]
    return node.mat()
