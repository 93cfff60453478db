"""Heads of PLY files: meshio waits for the end of one without end."""

from __future__ import annotations

import re
from pathlib import Path

from bcid.base.errors import InputError

_LONGEST = 100_000
_END = re.compile(rb"^\s*end_header\s*$", re.MULTILINE)


def refuse_open_head(file: Path) -> None:
    """Refuse a PLY file whose head has no end.

    Raises:
        InputError: no line is `end_header` within 100 kB.
    """
    with file.open("rb") as stream:
        head = stream.read(_LONGEST)
    if not _END.search(head):
        raise InputError("its head has no line end_header: it is truncated, or no PLY file; export it once more")
