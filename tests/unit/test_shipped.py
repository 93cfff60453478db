"""Examples that a user copies."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcid.base.errors import InputError
from bcid.base.shipped import copy_examples


@pytest.mark.parametrize("where", [".", "here", "made/here"])
def test_copy_examples_into_the_working_folder_or_another_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if where == "made/here":
        Path("made").mkdir()
    copy_examples(Path(where))
    assert (tmp_path / where / "examples" / "scenes" / "slab.toml").is_file()
    assert not list(tmp_path.rglob("*.partial"))
    with pytest.raises(InputError, match="is not empty"):
        copy_examples(Path(where))
