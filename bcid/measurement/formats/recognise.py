"""Which format a file has, found by its content."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from bcid.base.errors import InputError
from bcid.measurement.formats import (
    array_file,
    capture_c3d,
    dic_export,
    motive,
    nexus,
    pose_estimation,
    qualisys,
    ros_bag,
    trc,
)
from bcid.measurement.formats.foreign import Foreign, How

# Bytes by which a format is known.
_HEAD = 65536


@dataclass(frozen=True)
class Format:
    """A format of files.

    Attributes:
        name: "table" for one with a single header line, else that of its family.
        words: for people.
        read: its reader, of the files of a recording; None for tables with one header line, whose columns a mapping names.
        arrays: whether what a mapping names in it are paths of arrays.
        series: whether a recording may be several files.
    """

    name: str
    words: str
    read: Callable[[Sequence[Path], How], Foreign] | None
    arrays: bool = False
    series: bool = False


TABLE = Format("table", "table with a header line", None)
DIC = Format("dic", "CSV of image correlation", dic_export.read_series, series=True)
_MAT, _HDF5, _NPZ = (
    Format(one.lower(), f"{one} file", array_file.read_series, arrays=True) for one in ("MAT", "HDF5", "NPZ")
)


def _single(name: str, words: str, read: Callable[[Path, How], Foreign]) -> Format:
    """A format of which a recording is one file."""
    return Format(name, words, lambda paths, how: read(paths[0], how))


_C3D = _single("c3d", "C3D", capture_c3d.read)
_DLC_HDF5 = _single("dlc_hdf5", "HDF5 file of DeepLabCut", pose_estimation.read_dlc_hdf5)
_BAG = _single("bag", "ROS bag", ros_bag.read)
_BINARY = {
    b"MATLAB": _MAT,
    b"\x89HDF\r\n\x1a\n": _HDF5,
    b"#ROSBAG V": _BAG,
    b"SQLite format 3\0": _BAG,
    b"\x89MCAP": _BAG,
}
_TEXT: list[tuple[Callable[[str], bool], Format]] = [
    (lambda head: head.startswith("PathFileType"), _single("trc", "TRC", trc.read)),
    (lambda head: head.startswith("Format Version,"), _single("motive", "CSV of OptiTrack Motive", motive.read)),
    (nexus.recognised, _single("nexus", "CSV of Vicon Nexus", nexus.read)),
    (lambda head: head.startswith("NO_OF_FRAMES\t"), _single("qualisys", "TSV of Qualisys", qualisys.read)),
    (lambda head: head.startswith("scorer,"), _single("dlc", "CSV of DeepLabCut", pose_estimation.read_dlc)),
    (pose_estimation.recognised_anipose, _single("anipose", "3-D CSV of Anipose", pose_estimation.read_anipose)),
    (dic_export.recognised, DIC),
]


def recognise(path: Path) -> Format:
    """The format of a file, or of a folder with a ROS 2 bag, by its first bytes.

    Raises:
        InputError: it cannot be read, or is binary and of no format that is known.
    """
    if path.is_dir():
        if (path / ros_bag.BODY).is_file():
            return _BAG
        raise InputError(f"{path}: is a folder without metadata.yaml; expected a file, or the folder of a ROS 2 bag")
    head = _head(path)
    # A C3D file begins with the number of a block and an 80; the suffix is trusted where that is damaged.
    if path.suffix.lower() == ".c3d" or (head[1:2] == b"\x50" and head[:1] < b"\x20" and b"\0" in head):
        return _C3D
    found = next((found for begin, found in _BINARY.items() if head.startswith(begin)), None)
    if found is not None:
        # pandas writes the tables of DeepLabCut with pytables, which leaves its marks in the first groups.
        table = found is _HDF5 and b"PYTABLES_FORMAT_VERSION" in head and b"pandas_type" in head
        return _DLC_HDF5 if table else found
    if path.suffix.lower() == ".mat":
        return _MAT
    if head.startswith(b"PK\x03\x04") and path.suffix.lower() == ".npz":
        return _NPZ
    if head.startswith((b"\x1f\x8b", b"PK\x03\x04")):
        raise InputError(
            f"{path}: is compressed, or a workbook; unpack it, or save it as CSV, and import what is in it"
        )
    if b"\0" in head:
        raise InputError(f"{path}: is binary and of no format that is known; see docs/formats.md for those that are")
    text = head.decode("utf-8-sig", "replace")
    return next((found for recognised, found in _TEXT if recognised(text)), TABLE)


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(_HEAD)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def files(folder: Path, name: str) -> list[Path]:
    """The file, folder, or files of a pattern such as ``frame_*.csv`` in a folder, sorted by the numbers in their names."""
    if not any(sign in name for sign in "*?["):
        # A pipe or a device would be waited for.
        return [folder / name] if (folder / name).is_file() or (folder / name).is_dir() else []
    try:
        found = [path for path in folder.glob(name) if path.is_file()]
    except (ValueError, NotImplementedError, IndexError):
        return []
    return sorted(found, key=lambda path: [(len(n), n) for n in re.findall(r"\d+|\D+", str(path))])
