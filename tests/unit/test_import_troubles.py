"""`bcid import` where it cannot write, and of names that are unusual: one message, and nothing half-written."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from bcid.app.cli import main
from validation.reliability import foreign_files as made

_TABLE = "time,{0}_x,{0}_y,{0}_z\n" + "".join(f"{0.1 * k},{k},1,2\n" for k in range(5))


def test_import_read_only_folder_ends_with_3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.csv").write_text(_TABLE.format("tip"), encoding="utf-8")

    def refused(path: Path, *_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    # As Linux answers on a file system that is read-only, also of a file that is not there.
    read = Path.open
    monkeypatch.setattr(
        Path, "open", lambda path, mode="r", **more: (refused if "w" in mode else read)(path, mode, **more)
    )
    monkeypatch.setattr(Path, "unlink", refused)
    assert main(["import", str(tmp_path / "a.csv"), "--no-picture"]) == 3
    assert "read-only" in capfd.readouterr().err.lower()
    assert [file.name for file in tmp_path.iterdir()] == ["a.csv"]


def test_import_name_that_is_not_utf8_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / os.fsdecode(b"a\xff.csv")).write_text(_TABLE.format("tip"), encoding="utf-8")
    given = ["import", str(tmp_path / os.fsdecode(b"a\xff.csv")), "-o", str(tmp_path / "m.toml"), "--no-picture"]
    assert main(given) == 2
    assert "UTF-8" in capfd.readouterr().err
    assert len(list(tmp_path.iterdir())) == 1


def test_import_emoji_label_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(_TABLE.format("🦴"), encoding="utf-8")
    assert main(["import", str(tmp_path / "a.csv"), "--no-picture"]) == 0
    assert "🦴" in (tmp_path / "a.toml").read_text(encoding="utf-8")


def test_import_points_without_names_whose_mapping_cannot_be_placed_leaves_no_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pattern, place = made.vic3d(tmp_path), Path.replace
    before = sorted(tmp_path.iterdir())

    def replaced(path: Path, target: Path) -> Path:
        if target.name == "dense.toml":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return place(path, target)

    monkeypatch.setattr(Path, "replace", replaced)
    assert main(["import", str(tmp_path / pattern), "-o", str(tmp_path / "dense.toml"), "--no-picture"]) == 3
    assert "dense.toml: cannot be written: No space left" in capfd.readouterr().err
    assert sorted(tmp_path.iterdir()) == before
