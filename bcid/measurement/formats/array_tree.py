"""Arrays in a tree of structs, cells and groups, by paths such as ``results/Points3D``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

# A tree that is deeper, or has more arrays, is no recording.
_DEEPEST, _MOST = 16, 5000


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
    shapes = [_shape(leaf) for leaf in found.values()]
    made: dict[str, Any] = {"paths": np.array(list(found), dtype=str), "shapes": np.array(shapes, dtype=str)}
    for path in wanted:
        if path in found:
            made[str(wanted.index(path))] = _loaded(path, found[path])
    return made


def _shape(leaf: Any) -> str:
    shape = (len(leaf), *leaf[0].shape) if isinstance(leaf, list) else leaf.shape
    kind = (leaf[0] if isinstance(leaf, list) else leaf).dtype.kind
    return f"{'text' if kind in 'USO' else 'numbers'} {'x'.join(map(str, shape))}"


def _loaded(path: str, leaf: Any) -> Any:
    array = np.stack([np.asarray(part) for part in leaf]) if isinstance(leaf, list) else np.asarray(leaf)
    if array.dtype.kind == "O":
        array = array.astype(str)
    if array.dtype.kind == "S":
        array = np.char.decode(array, "utf-8", "replace")
    if array.dtype.kind not in "biufU":
        raise ValueError(f"{path} holds neither numbers nor text")
    return array if array.dtype.kind == "U" else array.astype(float)
