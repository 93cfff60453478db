"""Text, whole numbers, tuples, lists and dictionaries of a pickle, made from its opcodes: nothing is imported or called.

PyTables keeps the labels of a table so. `pickletools` only names the opcodes (Python documentation); each that could name a
function or a class is refused.
"""

from __future__ import annotations

import pickletools
from collections.abc import Callable
from typing import Any

_LONGEST = 1_000_000
_MARK = object()
_VALUES = frozenset({"INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1"})
_VALUES |= {"UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"}
_MADE: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_TUPLE": tuple,
    "EMPTY_LIST": list,
    "EMPTY_DICT": dict,
}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_IGNORED = frozenset({"PROTO", "FRAME"})


def literal(pickled: bytes) -> Any:
    """The value of a pickle that holds nothing but literals.

    Raises:
        ValueError: it holds anything else, is damaged, or longer than 1 MB.
    """
    if len(pickled) > _LONGEST:
        raise ValueError("is longer than labels are")
    stack: list[Any] = []
    kept: dict[int, Any] = {}
    try:
        for opcode, argument, _ in pickletools.genops(pickled):
            if opcode.name == "STOP" and len(stack) == 1:
                return stack[0]
            _step(opcode.name, argument, stack, kept)
    except (IndexError, KeyError, TypeError, RecursionError, UnicodeError):
        pass
    raise ValueError("is damaged")


def _step(name: str, argument: Any, stack: list[Any], kept: dict[int, Any]) -> None:
    if name in _VALUES:
        stack.append(argument)
    elif name in _MADE:
        stack.append(_MADE[name]())
    elif name == "MARK":
        stack.append(_MARK)
    elif name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
        kept[len(kept) if argument is None else argument] = stack[-1]
    elif name in ("GET", "BINGET", "LONG_BINGET"):
        stack.append(kept[argument])
    elif name in _TUPLES:
        count = _TUPLES[name]
        stack[-count:] = [tuple(stack[-count:])]
    elif name in ("TUPLE", "LIST", "DICT"):
        parts = _since_mark(stack)
        stack.append(tuple(parts) if name == "TUPLE" else parts if name == "LIST" else _pairs(parts))
    elif name in ("APPEND", "APPENDS"):
        parts = [stack.pop()] if name == "APPEND" else _since_mark(stack)
        stack[-1] += parts
    elif name in ("SETITEM", "SETITEMS"):
        parts = [stack.pop() for _ in "kv"][::-1] if name == "SETITEM" else _since_mark(stack)
        stack[-1].update(_pairs(parts))
    elif name not in _IGNORED:
        raise ValueError(f"holds a Python object ({name.lower()}), which is not made")


def _since_mark(stack: list[Any]) -> list[Any]:
    """Take the values above the last mark, and the mark."""
    at = len(stack) - 1
    while stack[at] is not _MARK:
        at -= 1
    parts = stack[at + 1 :]
    del stack[at:]
    return parts


def _pairs(parts: list[Any]) -> dict[Any, Any]:
    return dict(zip(parts[::2], parts[1::2], strict=True))
