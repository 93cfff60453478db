"""Binary files are read by processes of their own: what their readers share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bcid.base.confined import read_in_child
from bcid.base.errors import InputError

# Time of a reader, s, and how much more a byte of the file may take.
_SECONDS = 30.0
_SECONDS_PER_BYTE = 1e-6


def fetched(
    module: str, path: Path, what: str, arguments: Sequence[str] = (), *, in_place: bool = False
) -> dict[str, Any]:
    """Arrays by name that a reader makes of a file; see `bcid.base.confined.read_in_child`.

    Raises:
        InputError: the file is no readable `what`.
    """
    limit = _SECONDS + _SECONDS_PER_BYTE * path.stat().st_size
    try:
        return read_in_child(module, path, arguments, seconds=limit, in_place=in_place)
    except (InputError, TimeoutError) as error:
        raise InputError(f"{path}: is not a readable {what}: {error}; is it whole? Export or copy it again") from None


def needed(package: str) -> InputError:
    """That a package is missing, as the reader in the child says it."""
    return InputError(f"reading it needs the package {package}; install bcid[mocap]")
