"""Memory that is freed in pieces goes back to the system when it is told to."""

import os
import platform
from pathlib import Path

import pytest

from bcid.forms.solver.multigrid import trim

MIB = 2**20


def resident() -> int:
    """Bytes of this process that are in memory."""
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc is known to give memory back")
def test_what_is_freed_goes_back() -> None:
    pieces = [bytearray(4096) for _ in range(25_000)]
    # The last one keeps the heap from shrinking by itself.
    last = pieces.pop()
    before = resident()
    pieces.clear()
    assert trim()
    assert before - resident() > 60 * MIB
    assert len(last) == 4096
