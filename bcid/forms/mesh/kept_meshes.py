"""Meshes that outlive the process, in a folder that the environment names: for many commands on the same bodies."""

from __future__ import annotations

import io
import os
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError
from bcid.base.fingerprint import fingerprint
from bcid.base.run_folder import write_whole
from bcid.base.version import VERSION
from bcid.scene.geometry_file import PROGRAM, kind_of

Arrays = dict[str, Any]
VARIABLE = "BCID_MESHES"
# Words of gmsh's language with which a program reads other files or starts other programs, of which its text says nothing.
_LOOKS_AROUND = re.compile(
    rb"\b(Include|Merge|MergeWithBoundingBox|MergeFile|ShapeFromFile|SystemCall|NonBlockingSystemCall|Plugin|Open|FileExists"
    rb"|GetEnv|GetString|OnelabRun)\b"
)


def kept(path: Path, about: dict[str, Any], make: Callable[[], Arrays]) -> Arrays:
    """What `make` makes of a program of gmsh's, or has made of it before; `about` are all other things that it depends on.

    Without `BCID_MESHES`, of other files, and of a program that reads others, it is made.

    Raises:
        InputError: the variable names what is no folder.
        MachineError: the folder cannot be written to.
    """
    folder = os.environ.get(VARIABLE)
    if not folder or kind_of(path) != PROGRAM:
        return make()
    if not Path(folder).is_dir():
        raise InputError(f"{VARIABLE}: '{folder}' is no folder; make it, or unset {VARIABLE}")
    text = path.read_bytes()
    if _LOOKS_AROUND.search(text):
        return make()
    file = Path(folder) / f"{fingerprint(about | {'bcid': VERSION, 'program': text.hex()})}.npz"
    found = _read(file)
    if found is None:
        found = make()
        _write(file, found)
    return found


def _read(file: Path) -> Arrays | None:
    """The arrays of a file; None where it is not there, or is damaged."""
    try:
        with np.load(file, allow_pickle=False) as data:
            return {key: data[key] for key in data.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None


def _write(file: Path, arrays: Arrays) -> None:
    """Several processes may make the same mesh at once."""
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    whole = write_whole(file.with_name(f"{file.stem}-{os.getpid()}.npz"), stream.getvalue())
    whole.replace(file)
