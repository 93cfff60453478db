"""Tables of nothing but numbers, as text (CSV) or as an array of NumPy (NPY)."""

from __future__ import annotations

import re
from pathlib import Path
from tokenize import TokenError

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.base.text_file import read_text

Array = NDArray[np.float64]

# Numbers that a calibration may have.
_MOST = 1000


def read_table(path: Path) -> Array:
    """Numbers (rows, columns) of a text; a first row or first column of names is left out.

    Cells stand apart by commas, semicolons, tabs or blanks.

    Raises:
        InputError: it holds anything else, or rows of several lengths.
    """
    rows = [
        (number, [cell for cell in re.split(r"\s*[,;\t]\s*|\s+", line.strip()) if cell])
        for number, line in enumerate(read_text(path).lstrip("\ufeff").splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if rows and not any(map(_is_number, rows[0][1])):
        rows = rows[1:]
    if rows and not any(_is_number(cells[0]) for _, cells in rows):
        rows = [(number, cells[1:]) for number, cells in rows]
    for number, cells in rows:
        if wrong := [cell for cell in cells if not _is_number(cell)]:
            raise InputError(f"{path}:{number}: expected numbers with a decimal point, found {wrong[0][:60]!r}")
        if len(cells) != len(rows[0][1]):
            raise InputError(f"{path}:{number}: has {len(cells)} numbers, the first row has {len(rows[0][1])}")
    if not rows:
        raise InputError(f"{path}: not a calibration file: holds no numbers")
    return np.array([[float(cell) for cell in cells] for _, cells in rows])


def read_array(path: Path) -> Array:
    """Numbers of an NPY file.

    Raises:
        InputError: it is cut short, or holds objects, or more than any calibration has.
    """
    try:
        # Mapped, so that a header that promises too much takes no memory.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf" or array.size > _MOST:
            raise ValueError("expected an array of numbers, two cameras with 11 or 3 x 4 each")
        return np.array(array, dtype=float)
    except (OSError, ValueError, EOFError, SyntaxError, TokenError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: not a calibration file: {str(error).splitlines()[0][:200]}") from None


def _is_number(text: str) -> bool:
    return re.fullmatch(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", text, re.ASCII) is not None
