"""What kind of geometry a file is, by its name, and the unit of length that a label image states."""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path

from bcid.base.errors import InputError

PROGRAM, SURFACE, IMAGE, MESH = "program", "surface", "image", "mesh"
_KINDS = {".geo": PROGRAM, ".stl": SURFACE, ".ply": SURFACE, ".obj": SURFACE, ".nii": IMAGE, ".nii.gz": IMAGE}
# NIfTI (nifti1.h, nifti2.h): where the units stand in the headers of 348 and 540 bytes, and what the codes of lengths mean, m.
_UNITS_AT = {348: (123, "B"), 540: (500, "i")}
_HEADER = 540
_LENGTH_CODES = {1: 1.0, 2: 1e-3, 3: 1e-6}


def suffix_of(path: Path) -> str:
    """Suffix in small letters; of a compressed file with the one before it, as ".nii.gz"."""
    last = path.suffix.lower()
    return Path(path.stem).suffix.lower() + last if last == ".gz" else last


def kind_of(path: Path) -> str:
    """`PROGRAM` (a `.geo`), `SURFACE`, `IMAGE` (of labels) or `MESH`."""
    # gmsh and its relatives know .geo in small letters only.
    return MESH if path.suffix.lower() == ".geo" != path.suffix else _KINDS.get(suffix_of(path), MESH)


def sized(path: Path) -> bool:
    """Whether a mesh is made of it with elements of a given size; a mesh file is refined instead."""
    return kind_of(path) != MESH


def stated_unit(image: Path) -> float | None:
    """Unit of length of a NIfTI image, m; None where it states none.

    Raises:
        InputError: it is no NIfTI image.
    """
    try:
        with gzip.open(image) if suffix_of(image).endswith(".gz") else image.open("rb") as stream:
            head = stream.read(_HEADER)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"'{image.name}' cannot be read: {error}") from None
    for order in "<>":
        length = struct.unpack(f"{order}i", head[:4])[0] if len(head) >= 4 else 0
        if length in _UNITS_AT and len(head) >= length:
            at, code = _UNITS_AT[length]
            units = struct.unpack_from(f"{order}{code}", head, at)[0]
            return _LENGTH_CODES.get(units & 7)
    raise InputError(
        f"'{image.name}' is no NIfTI image (its first number is not 348 or 540); save it as .nii or .nii.gz"
    )
