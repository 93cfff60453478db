"""Reading in a child: what it may not do, whatever its reader tries."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bcid.base import confined
from bcid.base.confined import landlock, read_in_child
from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from bcid.comparison.source import from_run
from bcid.forms.mesh import level_mesh
from bcid.measurement import Measurement
from bcid.scene import Scene
from bcid.vision.images import Images

ROOT = Path(__file__).resolve().parents[2]

_TRIES = """
import os, subprocess, sys
from pathlib import Path
from bcid.base.confined import confine

inside, outside = Path(sys.argv[1]), Path(sys.argv[2])
assert confine([inside])

def tried(work):
    try:
        work()
        return "done"
    except PermissionError:
        return "refused"

print(tried((inside / "a").read_text))
print(tried(outside.read_text))
print(tried(lambda: (inside / "b").write_text("b")))
print(tried(lambda: outside.write_text("b")))
print(tried(lambda: os.unlink(inside / "a")))
print(tried(lambda: subprocess.run(["/bin/true"], check=True)))
print(os.system("true") != 0)
print(tried(lambda: __import__("wave")))
"""


@pytest.mark.skipif(landlock() == 0, reason="the kernel has no Landlock")
def test_a_confined_process_reads_its_folder_and_libraries_alone(tmp_path: Path) -> None:
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    (inside / "a").write_text("a", encoding="utf-8")
    outside.write_text("secret", encoding="utf-8")
    words = [sys.executable, "-c", _TRIES, str(inside), str(outside)]
    said = subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
    assert said == ["done", "refused", "refused", "refused", "refused", "refused", "True", "done"]


def test_without_landlock_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(confined, "landlock", lambda: 0)
    assert not confined.confine([tmp_path])


def test_the_environment_of_a_child_holds_no_plugins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("HDF5_PLUGIN_PATH", "GMSHPLUGINSHOME", "LD_PRELOAD", "PYTHONSTARTUP", "OMPI_COMM_WORLD_SIZE"):
        monkeypatch.setenv(name, "/evil")
    made = confined._environment(tmp_path)
    assert "/evil" not in made.values()
    assert made["HOME"] == made["TMPDIR"] == str(tmp_path)
    assert made["HDF5_PLUGIN_PRELOAD"] == "::"


def test_a_reader_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    (tmp_path / "a.c3d").write_bytes(b"x")
    with pytest.raises(TimeoutError, match=r"more than 0 s"):
        read_in_child("bcid.measurement.c3d", tmp_path / "a.c3d", seconds=0.01)


def test_an_hdf5_file_beside_its_xdmf_is_read(tmp_path: Path) -> None:
    """The one reference to another file that is followed."""
    meshio = pytest.importorskip("meshio")
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    points, cells, groups = (level_mesh(scene, scene.levels[0]).__dict__[k] for k in ("points", "cells", "groups"))
    meshio.write_points_cells(tmp_path / "m.xdmf", points, [("tetra", cells)], data_format="HDF")
    assert (tmp_path / "m.h5").is_file()
    assert groups
    arrays = read_in_child(
        "bcid.forms.mesh.child", tmp_path / "m.xdmf", ["0.0", "0.0"], seconds=60, beside=[tmp_path / "m.h5"]
    )
    np.testing.assert_array_equal(arrays["points"], points)
    np.testing.assert_array_equal(arrays["cells"], cells)
    with pytest.raises(InputError, match=r"only an HDF5 file beside it"):
        read_in_child("bcid.forms.mesh.child", tmp_path / "m.xdmf", ["0.0", "0.0"], seconds=60)


def test_a_file_that_is_too_long_to_copy_is_refused(tmp_path: Path) -> None:
    """A hole of a terabyte takes no space where it lies, and all of it where it is copied to."""
    with (tmp_path / "a.c3d").open("wb") as stream:
        stream.truncate(10**12)
    with pytest.raises(InputError, match=r"a\.c3d is no file of at most 2 GB"):
        read_in_child("bcid.measurement.c3d", tmp_path / "a.c3d", seconds=60)


@pytest.mark.timeout(60)
def test_pipes_are_not_waited_for(tmp_path: Path) -> None:
    folder = tmp_path / "seen"
    shutil.copytree(ROOT / "examples/measurements/slab-34-complex", folder)
    os.mkfifo(folder / "wrench.csv")
    with pytest.raises(InputError, match=r"wrench\.csv: is no regular file"):
        Measurement.read(folder)
    for name in ("scene.toml", "left.avi"):
        os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=r"scene\.toml: is no regular file"):
        Scene.read(tmp_path / "scene.toml")
    with pytest.raises(InputError, match=r"left\.avi: no such"):
        Images.open(tmp_path / "left.avi")


def test_effects_of_a_run_are_run_only_when_named_again(tmp_path: Path) -> None:
    """A run folder is data: a program that it names is not run."""
    file, ran = tmp_path / "effect.py", tmp_path / "ran"
    file.write_text(f"open({str(ran)!r}, 'w')\n", encoding="utf-8")
    run = RunFolder.start(tmp_path / "run", "explain", {"effects": ["0" * 12]})
    run.record["names"] = {"scene": "scene.toml", "measurement": "seen"}
    run.write_json("model.json", {"files": [str(file)], "law": {}, "effects": [], "anchored": [], "free": []})
    run.finish({})
    for given in ((), (file,)):
        with pytest.raises(
            InputError, match=r"run only when you name them, as they were then: add --effects .*effect\.py"
        ):
            from_run(tmp_path / "run", given, None)
    assert not ran.exists()
