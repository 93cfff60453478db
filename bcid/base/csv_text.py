"""Tables for spreadsheets, in which no text of others is a formula.

Measurement folders are not written with it: bcid reads them again, and their names must stay as they are.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable

# What spreadsheets take for the beginning of a formula, behind spaces too.
_FORMULA = re.compile(r"\s*[=+\-@\t\r]|[\t\r]")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Rows as CSV; numbers stay as they are, and a text like a formula begins with an apostrophe."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows([_harmless(cell) for cell in row] for row in rows)
    return stream.getvalue()


def _harmless(cell: object) -> object:
    risky = isinstance(cell, str) and _FORMULA.match(cell) and not _NUMBER.fullmatch(cell)
    return f"'{cell}" if risky else cell
