"""The heap of the C library, which keeps what is freed for later unless it is told otherwise."""

from __future__ import annotations

import ctypes
import os


def trim() -> bool:
    """Give the pages of this process that nothing uses back to the system; False where its C library has no way to (glibc has).

    Numbering a mesh and finding the pattern of a matrix free as many bytes as they leave, in pieces too small to go back by
    themselves, and what is allocated next is too large to go there.
    """
    found = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    return found is not None and bool(found(ctypes.c_size_t(0)))
