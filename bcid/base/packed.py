"""Arrays of numbers, and notes, as bytes and back: checked, and nothing that could be run, whoever wrote them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_CHECK, _LENGTH = 32, 8
# Kinds of numpy's types: booleans, integers, floating-point numbers.
_KINDS = "biuf"


def packed(arrays: Mapping[str, NDArray[Any]], notes: Any = None) -> bytes:
    """Arrays by name, and notes that JSON can hold, as bytes that begin with their checksum."""
    told = {name: [array.dtype.str, array.shape] for name, array in arrays.items()}
    head = json.dumps({"arrays": told, "notes": notes}).encode()
    content = [len(head).to_bytes(_LENGTH, "little"), head, *(array.tobytes() for array in arrays.values())]
    digest = hashlib.sha256()
    for part in content:
        digest.update(part)
    return b"".join([digest.digest(), *content])


def unpacked(content: bytes) -> tuple[dict[str, NDArray[Any]], Any]:
    """What was packed: arrays by name, which may be written to, and notes.

    Raises:
        ValueError: the bytes are damaged, or others.
    """
    view = memoryview(content)
    if hashlib.sha256(view[_CHECK:]).digest() != content[:_CHECK]:
        raise ValueError("the checksum is another")
    start = _CHECK + _LENGTH
    end = start + int.from_bytes(content[_CHECK:start], "little")
    try:
        head, arrays = json.loads(content[start:end]), {}
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    for name, (code, shape) in head["arrays"].items():
        kind = np.dtype(code)
        if kind.kind not in _KINDS:
            raise ValueError(f"{name} is no array of numbers")
        count = int(np.prod(shape, dtype=np.int64))
        arrays[name] = np.frombuffer(view, kind, count, end).reshape(shape).copy()
        end += arrays[name].nbytes
    return arrays, head["notes"]
