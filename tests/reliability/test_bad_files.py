"""Damaged and mutated files of every kind, reduced; docs/reliability.md has the full sizes."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from validation.reliability import Reached, configuration, folders, meshes, readers, recordings


def met(found: Reached) -> None:
    assert found.met, "\n".join([found.reached, *found.misses[:10]])


def test_mutated_meshes() -> None:
    """From a process of its own: what other tests have left in this one counts as memory of the children."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
        met(alone.submit(meshes.damage, 240).result())


def test_bad_configuration_and_measurements() -> None:
    met(configuration.refusals(800))


def test_mutated_c3d_recordings() -> None:
    pytest.importorskip("ezc3d")
    met(recordings.damage(8, seed=3))


def test_mutated_files_of_every_format() -> None:
    """In one process: libraries are loaded once."""
    ends, misses = readers.ends_of(readers.READERS, 2, seed=1)
    assert not misses, "\n".join(misses)
    assert ends.total() == 2 * len(readers.READERS)


def test_damaged_run_folders() -> None:
    met(folders.damage(300))


def test_another_number_in_a_result_is_noticed(tmp_path: Path) -> None:
    folder = folders.finished(tmp_path / "run")
    file = folder / "identification.json"
    file.write_text(file.read_text(encoding="utf-8").replace("0.98", "0.99"), encoding="utf-8")
    with pytest.raises(InputError, match=r"identification\.json: is damaged"):
        RunFolder.open(folder).read_json("identification.json")
    assert RunFolder.open(folder).read_dataset("body.nc")["measured"].size == 60
