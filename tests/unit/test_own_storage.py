"""HDF5 files of others whose values lie elsewhere: refused by every reader, never read as zeros."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.base.own_storage import refuse_outside
from bcid.measurement.inspection import import_file
from validation.reliability import foreign_files as made

h5py = pytest.importorskip("h5py")


def _virtual(file: Any, far: Path) -> None:
    with h5py.File(far, "w") as other:
        other["values"] = np.ones((4, 3))
    layout = h5py.VirtualLayout((4, 3), "f8")
    layout[...] = h5py.VirtualSource(str(far), "values", (4, 3))
    file.create_virtual_dataset("group/values", layout)


def _external(file: Any, far: Path) -> None:
    far.write_bytes(np.ones(12).tobytes())
    file.create_dataset("group/values", (4, 3), "f8", external=[(str(far), 0, 96)])


def _link(file: Any, far: Path) -> None:
    file["group/values"] = h5py.ExternalLink(str(far), "values")


def _filter(file: Any, _: Path) -> None:
    create = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    create.set_chunk((4, 3))
    create.set_filter(305, h5py.h5z.FLAG_OPTIONAL, ())
    group = file.create_group("group")
    space = h5py.h5s.create_simple((4, 3))
    h5py.h5d.create(group.id, b"values", h5py.h5t.IEEE_F64LE, space, create)


OUTSIDE: list[tuple[Callable[[Any, Path], None], str]] = [
    (_virtual, "the values of '/group/values' are kept in another file, or by reference; repack the file"),
    (_external, "the values of '/group/values' are kept in another file, or by reference; repack the file"),
    (_link, "'/group/values' is a link to the file '"),
    (_filter, "the values of '/group/values' pass the filter 305, a plugin; repack the file with gzip"),
]


@pytest.mark.parametrize(("write", "said"), OUTSIDE)
def test_an_hdf5_recording_whose_values_lie_elsewhere_is_refused(
    tmp_path: Path, write: Callable[[Any, Path], None], said: str
) -> None:
    with h5py.File(tmp_path / "take.h5", "w") as file:
        write(file, tmp_path / "far")
    with pytest.raises(InputError, match=said):
        import_file(tmp_path / "take.h5")


@pytest.mark.parametrize(("write", "said"), OUTSIDE)
def test_a_table_of_deeplabcut_with_values_elsewhere_is_refused(
    tmp_path: Path, write: Callable[[Any, Path], None], said: str
) -> None:
    pytest.importorskip("tables")
    with h5py.File(made.deeplabcut_hdf5(tmp_path), "r+") as file:
        write(file, tmp_path / "far")
    with pytest.raises(InputError, match=said):
        import_file(tmp_path / "dlc.h5")


def test_a_user_defined_link_is_refused(tmp_path: Path) -> None:
    """h5py makes none: the type of an external link is changed in the file."""
    path = tmp_path / "take.h5"
    with h5py.File(path, "w", libver="latest") as file:
        file.create_dataset("values", data=np.ones(3))
        file["linked"] = h5py.ExternalLink("somewhere", "values")
    content = path.read_bytes()
    at = content.index(b"linked") - 4
    # Link message, version 2 of object headers: type 64 of a link, its length of name, its name.
    found = content.rindex(b"\x40", at, at + 4)
    path.write_bytes(_checksummed(content[:found] + b"\x41" + content[found + 1 :]))
    with h5py.File(path, "r") as file, pytest.raises(InputError, match=r"'/linked' is a link of a kind"):
        refuse_outside(file)


def test_groups_that_hold_each_other_end(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "round.h5", "w") as file:
        for one, other in (("a", "b"), ("b", "a")):
            for number in range(3):
                file.require_group(one)[f"{other}{number}"] = file.require_group(other)
        file["soft"] = h5py.SoftLink("/nowhere")
        file["zipped"] = np.ones((10, 10))
        refuse_outside(file)
        group = file
        for _ in range(70):
            group = group.create_group("deeper")
        with pytest.raises(InputError, match="nested too deeply"):
            refuse_outside(file)


def _checksummed(content: bytes) -> bytes:
    """The content with the checksum of every version 2 object header (OHDR) made anew; for small headers alone."""
    changed, at = bytearray(content), 0
    while (at := content.find(b"OHDR", at)) >= 0:
        flags = content[at + 5]
        start = at + 6 + (16 if flags & 0x20 else 0) + (4 if flags & 0x10 else 0)
        width = 1 << (flags & 3)
        end = start + width + int.from_bytes(content[start : start + width], "little")
        changed[end : end + 4] = _lookup3(bytes(changed[at:end])).to_bytes(4, "little")
        at += 4
    return bytes(changed)


def _lookup3(data: bytes) -> int:
    """Bob Jenkins' lookup3, the checksum of HDF5 (H5_checksum_lookup3)."""
    most = 0xFFFFFFFF
    a = b = c = (0xDEADBEEF + len(data)) & most

    def turn(value: int, by: int) -> int:
        return (value << by | value >> (32 - by)) & most

    while len(data) > 12:
        words = [int.from_bytes(data[i : i + 4], "little") for i in (0, 4, 8)]
        a, b, c = ((old + word) & most for old, word in zip((a, b, c), words, strict=True))
        for first, second, third in ((4, 6, 8), (16, 19, 4)):
            a = ((a - c) & most) ^ turn(c, first)
            c = (c + b) & most
            b = ((b - a) & most) ^ turn(a, second)
            a = (a + c) & most
            c = ((c - b) & most) ^ turn(b, third)
            b = (b + a) & most
        data = data[12:]
    if not data:
        return c
    data = data.ljust(12, b"\0")
    words = [int.from_bytes(data[i : i + 4], "little") for i in (0, 4, 8)]
    a, b, c = ((old + word) & most for old, word in zip((a, b, c), words, strict=True))
    for by, one in ((14, "cb"), (11, "ac"), (25, "ba"), (16, "cb"), (4, "ac"), (14, "ba"), (24, "cb")):
        now = {"a": a, "b": b, "c": c}
        left, right = one
        now[left] = ((now[left] ^ now[right]) - turn(now[right], by)) & most
        a, b, c = now["a"], now["b"], now["c"]
    return c
