"""Tables that pandas wrote to HDF5, as DeepLabCut does: read without pandas, and nothing in them is run."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.measurement.formats.foreign import Foreign
from bcid.measurement.inspection import import_file
from validation.reliability import foreign_files as made

h5py = pytest.importorskip("h5py")
pd = pytest.importorskip("pandas")
pytest.importorskip("tables")

# What a reader that makes the object ends with.
_CODE = 77


class _Ends:
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return exec, (f"import os; os._exit({_CODE})",)


def _genuine(folder: Path, layout: str) -> Path:
    table = pd.read_hdf(made.deeplabcut_hdf5(folder))
    table.to_hdf(folder / "dlc.h5", key="df_with_missing", format=layout, mode="w")
    return folder / "dlc.h5"


@pytest.mark.parametrize("layout", ["fixed", "table"])
def test_a_table_of_deeplabcut_in_either_layout_is_read_as_pandas_does(tmp_path: Path, layout: str) -> None:
    read = import_file(_genuine(tmp_path, layout)).seen
    assert list(read.points) == list(made.LABELS)
    for i, label in enumerate(made.LABELS):
        np.testing.assert_array_equal(read.points[label], made.XYZ[:, i])


def test_a_block_of_objects_is_refused_and_not_unpickled(tmp_path: Path) -> None:
    table = pd.read_hdf(made.deeplabcut_hdf5(tmp_path)).astype(object)
    table.iloc[0, 0] = _Ends()
    with pytest.warns(pd.errors.PerformanceWarning):
        table.to_hdf(tmp_path / "dlc.h5", key="df_with_missing", format="fixed", mode="w")
    with pytest.raises(InputError, match=r"block0_values\) are kept as Python objects .* export it as CSV"):
        import_file(tmp_path / "dlc.h5")


@pytest.mark.parametrize("name", ["info", "values_block_0_kind"])
def test_labels_that_are_a_program_are_refused_and_not_unpickled(tmp_path: Path, name: str) -> None:
    with pytest.raises(
        InputError, match=r"holds a Python object \(__builtin__.exec\), which is not made; export it as CSV"
    ):
        _read_with_labels(tmp_path, name, pickle.dumps(_Ends(), 2))


def test_levels_that_are_objects_are_refused_and_not_unpickled(tmp_path: Path) -> None:
    path = _genuine(tmp_path, "fixed")
    with h5py.File(path, "r+") as file:
        group = file["df_with_missing"]
        del group["block0_items_level1"]
        level = group.create_dataset("block0_items_level1", (1,), dtype=h5py.vlen_dtype("u1"))
        level[0] = np.frombuffer(pickle.dumps(_Ends()), "u1")
        level.attrs["PSEUDOATOM"] = np.bytes_("object")
    with pytest.raises(InputError, match=r"block0_items_level1\) are kept as Python objects"):
        import_file(path)


@pytest.mark.parametrize(
    "pickled", [b"(", b"t.", b"g9\n.", b"I1\nI2\n.", b"(I1\nd.", b"\x80\x7f.", b"a.", b"P1\n.", b"\x80\x02\x82\x01."]
)
def test_labels_that_are_damaged_or_made_elsewhere_are_refused(tmp_path: Path, pickled: bytes) -> None:
    with pytest.raises(InputError, match=r"is damaged; export it as CSV|not laid out as pandas does it"):
        _read_with_labels(tmp_path, "info", pickled)


@pytest.mark.parametrize("protocol", [0, pickle.HIGHEST_PROTOCOL])
def test_labels_of_any_protocol_are_read(tmp_path: Path, protocol: int) -> None:
    with h5py.File(_genuine(tmp_path, "table")) as file:
        labels = pickle.loads(bytes(file["df_with_missing/table"].attrs["values_block_0_kind"]))
    read = _read_with_labels(tmp_path, "values_block_0_kind", pickle.dumps(labels, protocol))
    assert list(read.points) == list(made.LABELS)


def _read_with_labels(folder: Path, name: str, pickled: bytes) -> Foreign:
    """What is read of a genuine table whose attribute with labels is another pickle."""
    path = _genuine(folder, "table")
    with h5py.File(path, "r+") as file:
        group = file["df_with_missing"]
        (group if name == "info" else group["table"]).attrs[name] = np.void(pickled)
    return import_file(path).seen
