"""What files of others unpack to is judged by what they declare, before anything is unpacked."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

from bcid.base.errors import InputError

# Arrays of one recording, bytes: as many as the longest file that is read.
LARGEST = 2_000_000_000


def refuse_large(size: float, what: str, remedy: str, largest: int = LARGEST) -> None:
    """Refuse what declares more than is read.

    Args:
        size: what is declared, bytes.
        what: begins the message.
        remedy: ends it.
        largest: most that is read, bytes.

    Raises:
        InputError: it is more.
    """
    if not size <= largest:
        raise InputError(f"{what} {size / 1e9:.3g} GB, more than {largest / 1e9:g} GB; {remedy}")


def stored_arrays(file: Path | BinaryIO) -> dict[str, Any]:
    """The arrays of an NPZ archive, by name, none of them compressed: it takes no more memory than its file is long.

    Raises:
        ValueError: something in it is compressed, or is no plain array.
        OSError, EOFError, SyntaxError, MemoryError, zipfile.BadZipFile: it cannot be read.
    """
    import zipfile

    import numpy as np

    with zipfile.ZipFile(file) as archive:
        if any(member.compress_type != zipfile.ZIP_STORED for member in archive.infolist()):
            raise ValueError("its arrays are compressed")
    if not isinstance(file, Path):
        file.seek(0)
    with np.load(file, allow_pickle=False) as data:
        return {key: data[key] for key in data.files}
