"""Run folders: whole files, no silent overwriting, one writer, resuming."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from bcid.base.errors import InputError, MachineError
from bcid.base.run_folder import RunFolder, writing

INPUTS = {"scene": "abc", "options": {"seeds": 3}}


def test_a_finished_run_is_kept(tmp_path: Path) -> None:
    run = RunFolder.start(tmp_path / "run", "identify", INPUTS)
    run.write_json("identification.json", {"anchored": ["1"]})
    run.finish({"anchored": ["1"]})
    assert RunFolder.open(tmp_path / "run").record["state"] == "finished"
    assert sorted(p.name for p in (tmp_path / "run").iterdir()) == [".lock", "identification.json", "run.json"]
    with pytest.raises(InputError, match=r"finished run .*--overwrite"):
        RunFolder.start(tmp_path / "run", "identify", INPUTS)
    assert RunFolder.open(tmp_path / "run").read_json("identification.json") == {"anchored": ["1"]}
    again = RunFolder.start(tmp_path / "run", "identify", INPUTS, overwrite=True)
    assert not (tmp_path / "run/identification.json").exists()
    again.release()


def test_an_interrupted_run_goes_on(tmp_path: Path) -> None:
    run = RunFolder.start(tmp_path / "run", "identify", INPUTS)
    run.fail("killed")
    again = RunFolder.start(tmp_path / "run", "identify", INPUTS)
    assert again.resumed
    again.fail("killed again")
    with pytest.raises(InputError, match="other inputs or options"):
        RunFolder.start(tmp_path / "run", "identify", INPUTS | {"scene": "other"})
    with pytest.raises(InputError, match="other inputs or options"):
        RunFolder.start(tmp_path / "run", "explain", INPUTS)


def test_other_folders_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious", encoding="utf-8")
    for overwrite in (False, True):
        with pytest.raises(InputError, match="not a run"):
            RunFolder.start(tmp_path, "identify", INPUTS, overwrite)
    with pytest.raises(InputError, match="is a file"):
        RunFolder.start(tmp_path / "thesis.tex", "identify", INPUTS)
    assert (tmp_path / "thesis.tex").read_text(encoding="utf-8") == "precious"
    with pytest.raises(InputError, match="not a run folder"):
        RunFolder.open(tmp_path)


def test_overwriting_spares_what_is_not_the_runs(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home/.precious").write_text("mine", encoding="utf-8")
    for overwrite in (False, True):
        with pytest.raises(InputError, match="not a run"):
            RunFolder.start(tmp_path / "home", "identify", INPUTS, overwrite)
    run = RunFolder.start(tmp_path / "run", "identify", INPUTS)
    run.finish({})
    (tmp_path / "run/notes.txt").write_text("mine", encoding="utf-8")
    RunFolder.start(tmp_path / "run", "identify", INPUTS, overwrite=True).release()
    assert (tmp_path / "home/.precious").exists()
    assert (tmp_path / "run/notes.txt").exists()


def test_one_writer(tmp_path: Path) -> None:
    run = RunFolder.start(tmp_path / "run", "identify", INPUTS)
    with pytest.raises(InputError, match=f"being written by process {os.getpid()} on"):
        RunFolder.start(tmp_path / "run", "identify", INPUTS)
    run.release()
    RunFolder.start(tmp_path / "run", "identify", INPUTS).release()


def test_the_lock_of_a_dead_process_is_taken_over(tmp_path: Path) -> None:
    code = (
        "import os, sys; from bcid.base.run_folder import RunFolder; "
        f"RunFolder.start({str(tmp_path / 'run')!r}, 'identify', {INPUTS!r}); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code], check=False)
    run = RunFolder.start(tmp_path / "run", "identify", INPUTS)
    assert run.resumed
    run.release()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "x"}', '{"format": "bcid-run/2"}', "\xff"])
def test_damaged_records(tmp_path: Path, text: str) -> None:
    run = RunFolder.start(tmp_path / "run", "identify", INPUTS)
    run.finish({})
    (tmp_path / "run/run.json").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=r"run\.json"):
        RunFolder.open(tmp_path / "run")


def test_numbers_that_are_no_json_are_refused(tmp_path: Path) -> None:
    run = RunFolder.start(tmp_path / "run", "identify", INPUTS)
    with pytest.raises(ValueError, match="not JSON compliant"):
        run.write_json("x.json", {"rms": float("nan")})
    assert not list((tmp_path / "run").glob("*x.json*"))
    run.release()


def test_arrays_round_trip(tmp_path: Path) -> None:
    run = RunFolder.start(tmp_path / "run", "identify", INPUTS)
    data = xr.Dataset({"x": ("frame", np.arange(3.0))}, coords={"action": ("frame", ["a", "b", "c"])})
    run.write_dataset("x.nc", data)
    back = run.read_dataset("x.nc")
    assert list(back["action"].values) == ["a", "b", "c"]
    np.testing.assert_array_equal(back["x"].values, data["x"].values)
    (tmp_path / "run/x.nc").write_bytes(b"CDF")
    with pytest.raises(InputError, match="damaged"):
        run.read_dataset("x.nc")
    with pytest.raises(InputError, match="missing"):
        run.read_dataset("y.nc")
    run.release()


@pytest.mark.skipif(not os.access("/proc/sys", os.R_OK), reason="needs Linux")
def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(MachineError, match="cannot be written"):
        RunFolder.start("/proc/bcid-run", "identify", INPUTS)


def test_a_full_disk_leaves_no_half_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = RunFolder.start(tmp_path / "run", "identify", INPUTS)
    run.write_json("result.json", {"good": 1})

    def full(_fd: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MachineError, match="No space left on device"):
        run.write_json("result.json", {"good": 2})
    assert json.loads((tmp_path / "run/result.json").read_text(encoding="utf-8")) == {"good": 1}
    run.release()


@pytest.mark.parametrize(
    ("number", "remedy"),
    [(errno.ENOSPC, "free some space"), (errno.EROFS, "not mounted read-only"), (errno.EACCES, "you may write to")],
)
def test_the_remedy_fits_the_reason(tmp_path: Path, number: int, remedy: str) -> None:
    with pytest.raises(MachineError, match=f"run: cannot be written: .*{remedy}") as found, writing(tmp_path / "run"):
        raise OSError(number, os.strerror(number))
    assert ("free some space" in str(found.value)) == (number == errno.ENOSPC)


def test_overwriting_removes_what_the_command_makes_and_nothing_beside(tmp_path: Path) -> None:
    """The names stand in run.json, which may be a stranger's: none leads out of the folder."""
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.tex").write_text("42", encoding="utf-8")
    makes = ["picture.png", "paraview/", "../precious/", "../precious/thesis.tex", str(precious) + "/", "./", ".."]
    run = RunFolder.start(tmp_path / "run", "identify", INPUTS, makes=makes)
    for name in ("picture.png", "notes.txt", "paraview/step.vtu"):
        (run.path / name).parent.mkdir(exist_ok=True)
        (run.path / name).write_text("x", encoding="utf-8")
    run.finish({})
    RunFolder.start(tmp_path / "run", "explain", INPUTS, overwrite=True).release()
    assert sorted(p.name for p in run.path.iterdir()) == [".lock", "notes.txt", "run.json"]
    assert (precious / "thesis.tex").exists()
