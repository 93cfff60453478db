"""Meshes that one process has made serve the next, where they are sure to be what it would make itself."""

from pathlib import Path

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.forms.mesh.kept_meshes import VARIABLE, Arrays, kept

ABOUT = {"arguments": ["0.01", "0.01"]}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    made = tmp_path / "meshes"
    made.mkdir()
    monkeypatch.setenv(VARIABLE, str(made))
    return made


@pytest.fixture
def body(tmp_path: Path) -> Path:
    file = tmp_path / "body.geo"
    file.write_text("Box(1) = {0, 0, 0, 1, 1, 1};", encoding="utf-8")
    return file


class Mesher:
    """Makes another mesh each time."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> Arrays:
        self.count += 1
        return {"points": np.full((2, 3), float(self.count)), "notes": np.array(["one", "two"])}


def test_a_mesh_is_made_once(folder: Path, body: Path) -> None:
    made = Mesher()
    first, again = kept(body, ABOUT, made), kept(body, ABOUT, made)
    assert made.count == 1
    assert list(first) == list(again)
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize("change", ["program", "size"])
def test_what_is_not_the_same_is_made_anew(folder: Path, body: Path, change: str) -> None:
    made = Mesher()
    kept(body, ABOUT, made)
    if change == "program":
        body.write_text("Box(1) = {0, 0, 0, 1, 1, 2};", encoding="utf-8")
    kept(body, {"arguments": ["0.02", "0.01"]} if change == "size" else ABOUT, made)
    assert made.count == len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("line", ['Merge "other.step";', 'Include "sizes.geo";', 'h = GetEnv("SIZE");'])
def test_a_program_that_reads_other_files_is_run(folder: Path, body: Path, line: str) -> None:
    body.write_text(line, encoding="utf-8")
    made = Mesher()
    kept(body, ABOUT, made)
    kept(body, ABOUT, made)
    assert made.count == 2
    assert not list(folder.iterdir())


def test_a_damaged_mesh_is_made_anew(folder: Path, body: Path) -> None:
    made = Mesher()
    kept(body, ABOUT, made)
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes()[:100])
    assert kept(body, ABOUT, made)["points"][0, 0] == 2.0
    assert kept(body, ABOUT, made)["points"][0, 0] == 2.0


def test_nothing_is_kept_unless_it_is_asked_for(body: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made = Mesher()
    monkeypatch.delenv(VARIABLE, raising=False)
    kept(body, ABOUT, made)
    kept(body, ABOUT, made)
    assert made.count == 2
    monkeypatch.setenv(VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match=r"BCID_MESHES: '.*nowhere' is no folder; make it, or unset BCID_MESHES"):
        kept(body, ABOUT, made)
