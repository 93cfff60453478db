"""Bulk data of Nastran: what has no begin or no end is refused, never waited for."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from bcid.base.confined import read_in_child
from bcid.base.errors import InputError

_POINTS = np.array([[0.0, 0, 0], [100, 0, 0], [0, 100, 0], [0, 0, 100]])


@pytest.fixture
def file(tmp_path: Path) -> Path:
    meshio.write_points_cells(tmp_path / "body.bdf", _POINTS, [("tetra", [[0, 1, 2, 3]])])
    return tmp_path / "body.bdf"


@pytest.mark.parametrize("missing", ["BEGIN BULK", "ENDDATA"])
def test_bulk_data_without_begin_or_end_are_refused(file: Path, missing: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert missing in text
    file.write_text(text.replace(missing, ""), encoding="utf-8")
    with pytest.raises(InputError, match=f"has no line {missing}: it is truncated, or no bulk data of Nastran"):
        read_in_child("bcid.forms.mesh.child", file, ["0.0", "0.0", "inf"], seconds=20)


def test_bulk_data_that_end_where_they_begin_are_refused(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    file.write_text(text[: text.index("BEGIN BULK") + 11], encoding="utf-8")
    with pytest.raises(InputError, match="has no line ENDDATA"):
        read_in_child("bcid.forms.mesh.child", file, ["0.0", "0.0", "inf"], seconds=5)


def test_whole_bulk_data_are_read(file: Path) -> None:
    found = read_in_child("bcid.forms.mesh.child", file, ["0.0", "0.0", "inf"], seconds=60)
    np.testing.assert_allclose(found["points"], _POINTS)
    assert found["cells"].tolist() == [[0, 1, 2, 3]]
