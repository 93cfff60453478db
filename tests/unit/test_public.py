"""What is answered about measurements made by others: a table, and folders that are not those."""

from __future__ import annotations

from pathlib import Path

import pytest

from validation import public
from validation.__main__ import main


def test_a_folder_without_the_data_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "human_skin").mkdir()
    assert main(["public", str(tmp_path), "-o", str(tmp_path / "run")]) == 2
    assert "has no folder fingerprint_plates and no folder duodic_rubber" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_the_table_has_a_row_for_each_measurement() -> None:
    row = dict.fromkeys(("measurement", "guess", "found", "published", "not known"), "x")
    text = public.table([row | {"measurement": "beam"}, row | {"measurement": "strip"}]).text()
    assert "beam" in text
    assert "not known" in text
