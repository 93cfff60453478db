"""Run folders that somebody has changed are refused in words, or shown without what was changed."""

from __future__ import annotations

from pathlib import Path

import pytest
import runs

import bcid
from bcid.base.errors import InputError
from bcid.base.inside_folder import read_inside
from bcid.base.run_folder import RunFolder
from bcid.report.found import Found
from bcid.search.answer.source import from_run
from validation.reliability.foreign_runs import ABSURD, CHANGES, SECRET, absurd, explained

# A FIFO without a writer would be waited for.
pytestmark = pytest.mark.timeout(60)


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", ["summary.txt", "diagnosis.json", "body.nc"])
def test_found_changed_file_is_named_and_not_shown(tmp_path: Path, change: str, name: str) -> None:
    folder = explained(tmp_path / "run")
    CHANGES[change](folder, name)
    found = Found.read(folder)
    assert any(str(folder / name) in trouble for trouble in found.troubles)
    assert SECRET not in str(found)


@pytest.mark.parametrize("change", CHANGES)
def test_open_changed_record_is_refused(tmp_path: Path, change: str) -> None:
    folder = explained(tmp_path / "run")
    CHANGES[change](folder, "run.json")
    with pytest.raises(InputError, match=r"run\.json"):
        RunFolder.open(folder)


@pytest.mark.parametrize("change", CHANGES)
def test_from_run_changed_model_is_refused(tmp_path: Path, change: str) -> None:
    folder = explained(tmp_path / "run")
    CHANGES[change](folder, "model.json")
    with pytest.raises(InputError, match=r"model\.json"):
        from_run(folder, [], None)


@pytest.mark.parametrize("name", ABSURD)
def test_read_dataset_absurd_body_is_refused(tmp_path: Path, name: str) -> None:
    folder = explained(tmp_path / "run")
    absurd(folder, name)
    with pytest.raises(InputError, match=rf"body\.nc: is damaged: .*{name}"):
        RunFolder.open(folder).read_dataset("body.nc")


def test_found_file_that_is_not_listed_is_not_used(tmp_path: Path) -> None:
    folder = runs.started(tmp_path / "run").path
    (folder / "summary.txt").write_text(SECRET)
    assert Found.read(folder).summary == ""


def test_load_changed_file_is_refused(tmp_path: Path) -> None:
    folder = runs.explained(tmp_path / "run")
    (folder / "identification.json").unlink()
    with pytest.raises(InputError, match=r"identification\.json: is missing"):
        bcid.load(folder)


def test_read_inside_link_on_the_way_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other/a.txt").write_text(SECRET)
    (tmp_path / "run").mkdir()
    (tmp_path / "run/steps").symlink_to(tmp_path / "other")
    for name in ("steps/a.txt", "../other/a.txt", str(tmp_path / "other/a.txt")):
        with pytest.raises(InputError):
            read_inside(tmp_path / "run", name)
