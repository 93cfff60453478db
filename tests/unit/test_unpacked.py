"""Compressed files of others that unpack to far more than they hold: refused by what they declare, before they are unpacked."""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.forms.mesh import label_image
from bcid.measurement.inspection import import_file
from bcid.vision import corners
from validation.reliability.scanned import image

SMALL = np.ones((4, 4, 4), np.uint8)


def _declared(file: Path, shape: tuple[int, ...]) -> Path:
    """A packed label image whose header declares another shape."""
    content = bytearray(gzip.decompress(image(file, SMALL, np.eye(4)).read_bytes()))
    content[42:48] = np.array(shape, "<i2").tobytes()
    file.write_bytes(gzip.compress(bytes(content)))
    return file


def test_a_label_image_that_declares_too_many_voxels_is_refused(tmp_path: Path) -> None:
    file = _declared(tmp_path / "body.nii.gz", (30_000, 30_000, 1_000))
    with pytest.raises(InputError, match=r"its header declares 900 GB, more than 1 GB; crop it to the body"):
        label_image.surface_of_label(file, 1)


def test_a_label_image_whose_voxels_begin_too_late_is_refused(tmp_path: Path) -> None:
    file = image(tmp_path / "body.nii.gz", SMALL, np.eye(4))
    content = bytearray(gzip.decompress(file.read_bytes()))
    content[108:112] = np.array([5e11], "<f4").tobytes()
    file.write_bytes(gzip.compress(bytes(content)))
    with pytest.raises(InputError, match="its header declares 500 GB, more than 1 GB"):
        label_image.surface_of_label(file, 1)


@pytest.mark.parametrize("kind", [".mat", ".h5"])
def test_a_recording_that_declares_too_much_is_refused(tmp_path: Path, kind: str) -> None:
    file = {".mat": _compressed_mat, ".h5": _compressed_hdf5}[kind](tmp_path / f"take{kind}")
    assert file.stat().st_size < 100_000
    with pytest.raises(InputError, match=r"unpacks to [0-9.]+ GB, more than 2 GB; keep only what is to be read"):
        import_file(file)


def _compressed_hdf5(file: Path) -> Path:
    h5py = pytest.importorskip("h5py", reason="reading HDF5 is optional")
    with h5py.File(file, "w") as content:
        content.create_dataset("points", (300_000, 1_000, 3), "f8", chunks=(1_000, 100, 3), compression="gzip")
    return file


def _compressed_mat(file: Path) -> Path:
    """A compressed variable whose head declares 20,000 x 20,000 numbers."""
    head = struct.pack("<IIIIiiII", 6, 8, 6, 0, 5, 8, 20_000, 20_000)
    variable = struct.pack("<II", 14, 56 + 8 * 20_000**2) + head + struct.pack("<I4s", 1 | 1 << 16, b"x")
    packed = zlib.compress(variable + struct.pack("<II", 9, 8 * 20_000**2) + bytes(10_000))
    text = b"MATLAB 5.0 MAT-file".ljust(124)
    file.write_bytes(text + struct.pack("<HH", 0x0100, 0x4D49) + struct.pack("<II", 15, len(packed)) + packed)
    return file


def test_a_packed_table_of_corners_is_unpacked_up_to_a_limit(tmp_path: Path) -> None:
    file = tmp_path / "corners.csv.gz"
    file.write_bytes(gzip.compress(b"pair,corner,x,y,u1,v1,u2,v2\n" + b"1," * 60_000_000))
    with pytest.raises(InputError, match=r"corners.csv.gz: is longer than 100 MB, the most that is read"):
        corners._lines(file)
