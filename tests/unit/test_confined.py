"""Reading in a child: what it may not do, whatever its reader tries."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.base import confined
from bcid.base.confined import environment_of_child, read_in_child
from bcid.base.errors import InputError
from bcid.base.landlock import landlock
from bcid.base.run_folder import RunFolder
from bcid.base.system_calls import seccomp
from bcid.forms.mesh import level_mesh
from bcid.measurement import Measurement
from bcid.scene import Scene
from bcid.search.answer.source import from_run
from bcid.vision.images import Images

ROOT = Path(__file__).resolve().parents[2]

# What each barrier holds off by itself, of what `forbidden` tries. Landlock of version 6 and newer holds signals too.
_BY_LANDLOCK = (
    "exec, subprocess, write inside, write outside, truncate, append, delete, make a folder, rename, link, read outside"
)
_BEYOND_SECCOMP = {"read outside"}
# There are no such calls, so that the C library and Python take others, which the filter sees into.
_ABSENT = {"clone3": f"failed {errno.ENOSYS}", "openat2": f"failed {errno.ENOSYS}"}


def _tried(folder: Path, barriers: str, user: str) -> dict[str, str]:
    inside, outside = folder / "inside", folder / "outside"
    inside.mkdir()
    for file in (inside / "a", outside):
        file.write_text("a", encoding="utf-8")
        file.chmod(0o666)
    for above in (inside, folder, *folder.parents[:3]):
        above.chmod(0o777)
    words = [sys.executable, "-m", "forbidden", str(inside), str(outside), barriers, user]
    paths = os.pathsep.join([str(ROOT), str(ROOT / "tests/unit")])
    done = subprocess.run(
        words,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": paths},
    )
    assert done.returncode == -signal.SIGABRT, done.stderr
    ends = dict(line.split(": ") for line in done.stdout.splitlines())
    assert (inside / "a").read_text(encoding="utf-8") == "a"
    if barriers != "landlock":
        assert outside.read_text(encoding="utf-8") == "a"
    assert ends.pop("allowed") == "done"
    return ends


_USERS = [
    "root",
    pytest.param("ordinary", marks=pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")),
]
_LANDLOCK = pytest.mark.skipif(landlock() == 0, reason="the kernel has no Landlock")
_SECCOMP = pytest.mark.skipif(bool(seccomp()), reason="the machine has no libseccomp")


@_LANDLOCK
@_SECCOMP
@pytest.mark.parametrize("user", _USERS)
def test_a_confined_process_may_do_nothing_but_read_its_folder_and_compute(tmp_path: Path, user: str) -> None:
    ends = _tried(tmp_path, "both", user)
    assert ends.pop("barriers") == "(True, True)"
    assert {name: end for name, end in ends.items() if end != "refused"} == {
        n: _ABSENT[n] for n in _ABSENT if n in ends
    }


@_SECCOMP
@pytest.mark.parametrize("user", _USERS)
def test_without_landlock_the_filter_of_system_calls_holds_all_but_reading(tmp_path: Path, user: str) -> None:
    ends = _tried(tmp_path, "seccomp", user)
    assert ends.pop("barriers") == "(False, True)"
    assert {name for name, end in ends.items() if end == "done"} == _BEYOND_SECCOMP
    assert {name for name, end in ends.items() if end not in ("done", "refused")} == set(_ABSENT) & ends.keys()


@_LANDLOCK
@pytest.mark.parametrize("user", _USERS)
def test_without_libseccomp_landlock_holds_files_and_programs(tmp_path: Path, user: str) -> None:
    ends = _tried(tmp_path, "landlock", user)
    assert ends["barriers"] == "(True, False)"
    held = {name for name, end in ends.items() if end != "done"}
    assert held >= set(_BY_LANDLOCK.split(", "))
    assert ("kill" in held) or landlock() < 6
    # A limit of processes does not bind root.
    assert ("fork" in held) == (user == "ordinary")


def test_the_environment_of_a_child_holds_no_plugins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("HDF5_PLUGIN_PATH", "GMSHPLUGINSHOME", "LD_PRELOAD", "PYTHONSTARTUP", "OMPI_COMM_WORLD_SIZE"):
        monkeypatch.setenv(name, "/evil")
    made = confined.environment_of_child(tmp_path)
    assert "/evil" not in made.values()
    assert made["HOME"] == made["TMPDIR"] == str(tmp_path)
    assert made["HDF5_PLUGIN_PRELOAD"] == "::"


def test_a_reader_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    (tmp_path / "a.c3d").write_bytes(b"x")
    with pytest.raises(TimeoutError, match=r"more than 0 s"):
        read_in_child("bcid.measurement.formats.capture_c3d", tmp_path / "a.c3d", seconds=0.01)


def test_an_hdf5_file_beside_its_xdmf_is_read(tmp_path: Path) -> None:
    """The one reference to another file that is followed."""
    meshio = pytest.importorskip("meshio")
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    points, cells, groups = (level_mesh(scene, scene.levels[0]).__dict__[k] for k in ("points", "cells", "groups"))
    meshio.write_points_cells(tmp_path / "m.xdmf", points, [("tetra", cells)], data_format="HDF")
    assert (tmp_path / "m.h5").is_file()
    assert groups
    arrays = read_in_child(
        "bcid.forms.mesh.child", tmp_path / "m.xdmf", ["0.0", "0.0", "inf"], seconds=60, beside=[tmp_path / "m.h5"]
    )
    np.testing.assert_array_equal(arrays["points"], points)
    np.testing.assert_array_equal(arrays["cells"], cells)
    with pytest.raises(InputError, match=r"only an HDF5 file beside it"):
        read_in_child("bcid.forms.mesh.child", tmp_path / "m.xdmf", ["0.0", "0.0", "inf"], seconds=60)


def test_a_file_that_is_too_long_to_copy_is_refused(tmp_path: Path) -> None:
    """A hole of a terabyte takes no space where it lies, and all of it where it is copied to."""
    with (tmp_path / "a.c3d").open("wb") as stream:
        stream.truncate(10**12)
    with pytest.raises(InputError, match=r"a\.c3d is no file of at most 2 GB"):
        read_in_child("bcid.measurement.formats.capture_c3d", tmp_path / "a.c3d", seconds=60)


_FORKS = """
import os, sys, time
from pathlib import Path
from bcid.base import confined

def read(source, arguments):
    for _ in range(3):
        if os.fork() == 0:
            time.sleep(60)
            os._exit(0)
    {then}
    return {{}}

confined.compute_only = lambda: False
sys.exit(confined.serve(read))
"""


@pytest.mark.parametrize("then", ["pass", "time.sleep(60)", "os._exit(3)", "raise ValueError"])
@pytest.mark.skipif(os.geteuid() != 0, reason="a user that is not root cannot fork in the child in any case")
def test_what_a_reader_starts_is_gone_when_reading_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, then: str
) -> None:
    (tmp_path / "forking.py").write_text(_FORKS.format(then=then), encoding="utf-8")
    (tmp_path / "some.dat").write_bytes(b"x")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    groups: list[int] = []
    began = subprocess.Popen

    def started(*words: Any, **options: Any) -> Any:
        child = began(*words, **options)
        groups.append(child.pid)
        return child

    monkeypatch.setattr(subprocess, "Popen", started)
    with suppress(InputError, TimeoutError):
        read_in_child("forking", tmp_path / "some.dat", seconds=3)
    assert groups
    # A process that is killed takes a moment to go.
    for _ in range(100):
        if not (left := _alive(groups[0])):
            break
        time.sleep(0.05)
    assert not left


def _alive(group: int) -> list[int]:
    """Processes of a group that are no zombies."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, its_group = entry.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[:3]
            found += [int(entry.parent.name)] if int(its_group) == group and state not in "ZX" else []
    return found


_REFUSING = """
import sys
from bcid.base.confined import serve

def read(source, arguments):
    raise ValueError("line 1\\nline 2\\rline 3\\u2028line 4")

sys.exit(serve(read))
"""


def test_reason_of_a_reader_is_passed_on_as_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file cannot make it begin where it likes."""
    (tmp_path / "refusing.py").write_text(_REFUSING, encoding="utf-8")
    (tmp_path / "some.dat").write_bytes(b"x")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(InputError, match=r"^line 1 line 2 line 3 line 4$"):
        read_in_child("refusing", tmp_path / "some.dat", seconds=30)


_TAKEN_OVER = """
import sys, zipfile
from pathlib import Path
with zipfile.ZipFile(sys.argv[2], "w", zipfile.ZIP_DEFLATED) as out:
    {what}
"""


@pytest.mark.parametrize(
    "what", ['out.writestr("a.npy", bytes(10**8))', 'out.close(); Path(sys.argv[2]).write_text("x")', "pass"]
)
def test_a_reader_that_gives_back_no_plain_arrays_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    (tmp_path / "taken_over.py").write_text(_TAKEN_OVER.format(what=what), encoding="utf-8")
    (tmp_path / "some.dat").write_bytes(b"x")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    if what == "pass":
        assert read_in_child("taken_over", tmp_path / "some.dat", seconds=30) == {}
        return
    with pytest.raises(InputError, match="gave back nothing that can be read"):
        read_in_child("taken_over", tmp_path / "some.dat", seconds=30)


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


def test_environment_of_child_libraries_of_relative_folders_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{tmp_path}::here:")
    assert environment_of_child(tmp_path)["LD_LIBRARY_PATH"] == str(tmp_path)
