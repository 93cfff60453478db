"""Reading the files of others in a process of its own, which can start nothing and open nothing else.

Readers of meshes and recordings open side files of their own accord, follow references in a file, and die of damaged
ones. So a file is copied under a neutral name into an empty folder, and read there by a child process with next to no
environment, limited time and limited memory. It gives up all rights over files but to read that folder and the installed
libraries (`landlock`), and all system calls but those for computing and reading (`system_calls`), whatever its reader does.
Its process group is killed at the end, however it ends.
"""

from __future__ import annotations

import ctypes
import math
import os
import resource
import shutil
import signal
import site
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from bcid.base.errors import InputError
from bcid.base.landlock import read_only
from bcid.base.scratch import require, temporary_folder
from bcid.base.shipped import IMPORT_ROOT
from bcid.base.system_calls import compute_only
from bcid.base.unpacked import stored_arrays

# What a child is given of the environment: where its libraries are, and how it writes text. Nothing that loads plugins.
_LIBRARIES = "LD_LIBRARY_PATH"
_KEPT = (_LIBRARIES, "PYTHONHOME", "LANG", "LC_ALL", "LC_CTYPE")
# Of a child that reads a file, bytes of address space, and how much more a byte of the file may take.
_SPACE = 2_000_000_000
_PER_BYTE = 100
# Longest file that is copied, bytes: a mesh of as many elements as can be solved on is a quarter of it.
_LONGEST_FILE = 2_000_000_000
# Longest reason of a child that is passed on.
_LONGEST = 300
# What a child writes at most, bytes: the arrays of its file.
_LONGEST_RESULT = 8_000_000_000
# Of what a child says, bytes of its end that are looked at.
_END = 10_000
# While a child is waited for, seconds from one look to the next.
_PAUSE = 0.01
_PARENT_DEATH_SIGNAL = 1


def read_in_child(
    module: str,
    source: Path,
    arguments: Sequence[str] = (),
    *,
    seconds: float,
    beside: Iterable[Path] = (),
    in_place: bool = False,
    check: Callable[[Path], None] | None = None,
) -> dict[str, Any]:
    """Arrays by name that ``python -m MODULE FILE OUT.npz ARGUMENT ...`` makes of a copy of a file.

    Args:
        module: calls `serve` with its reader.
        source: the file; links are followed, and it is read as what its own name says, not as what the link's target is called.
        arguments: passed on.
        seconds: after which the child is ended.
        beside: files that it may name, copied under their own names.
        in_place: a program such as a `.geo`, which may name other files of its folder, is read where it lies.
        check: looks at the copy before it is read; raises `InputError`.

    Raises:
        InputError: the reader refuses the file or dies; the text is the reader's last line.
        TimeoutError: it takes too long.
        MachineError: the temporary folder is full, or cannot be written.
    """
    with temporary_folder("bcid-read-") as folder:
        out = folder / "out.npz"
        file = source.resolve() if in_place else _copied(source, beside, folder / "in")
        if check is not None:
            check(file)
        command = [sys.executable, "-P", "-m", module, str(file), str(out), *arguments]
        code, said = _run(command, folder, seconds)
        if code != 0:
            require()
            reason = said[-1] if said else f"the reader died with code {code}"
            raise InputError(reason.replace(str(file), source.name)[:_LONGEST])
        return _arrays(out)


def _run(command: Sequence[str], folder: Path, seconds: float) -> tuple[int, list[str]]:
    """Exit code of a child, and what it said, line by line; its process group is gone afterwards."""
    said = [folder / name for name in ("said", "faults")]
    with said[0].open("wb") as output, said[1].open("wb") as faults:
        child = subprocess.Popen(
            command,
            env=environment_of_child(folder),
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=faults,
            start_new_session=True,
        )
        try:
            with suppress(OSError):
                limit = math.ceil(seconds) + 1
                resource.prlimit(child.pid, resource.RLIMIT_CPU, (limit, limit))
            if not _ends(child.pid, seconds):
                raise TimeoutError(f"reading took more than {seconds:.0f} s")
        finally:
            # The child is not reaped before: until then its number is nobody else's.
            with suppress(OSError):
                os.killpg(child.pid, signal.SIGKILL)
            code = child.wait()
    return code, b"\n".join(map(_end, said)).decode("utf-8", "replace").strip().splitlines()


def _end(file: Path) -> bytes:
    with file.open("rb") as stream:
        stream.seek(max(0, file.stat().st_size - _END))
        return stream.read()


def _ends(child: int, seconds: float) -> bool:
    """Wait for the end of a process, and leave it to be reaped; False when it takes longer."""
    latest = time.monotonic() + seconds
    while os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        if time.monotonic() > latest:
            return False
        time.sleep(_PAUSE)
    return True


def _arrays(out: Path) -> dict[str, Any]:
    """What a child gave back. It may have been taken over: nothing is unpickled, and nothing grows as it is unpacked."""
    try:
        return stored_arrays(out)
    except (OSError, ValueError, EOFError, SyntaxError, MemoryError, zipfile.BadZipFile):
        require()
        raise InputError("the reader gave back nothing that can be read") from None


def _copied(source: Path, beside: Iterable[Path], folder: Path) -> Path:
    """Copies of files in a folder of their own; returns that of the source."""
    try:
        for file in (source, *beside):
            if not file.is_file() or file.stat().st_size > _LONGEST_FILE:
                raise InputError(f"{file.name} is no file of at most {_LONGEST_FILE / 1e9:g} GB")
        folder.mkdir()
        for other in beside:
            shutil.copyfile(other, folder / other.name)
        return shutil.copyfile(source, folder / f"body{_suffix(source)}")
    except OSError as error:
        require()
        raise InputError(f"cannot be read: {error.strerror or error}") from None


def _suffix(source: Path) -> str:
    """What says how a file is read: its last suffix, of a compressed one the two last."""
    return "".join(source.suffixes[-2:]) if source.suffix.lower() == ".gz" else source.suffix


def environment_of_child(folder: Path) -> dict[str, str]:
    """Of a child: no program is found by name, nothing is configured from the user's home, HDF5 loads no plugins."""
    kept = {name: value for name, value in os.environ.items() if name in _KEPT}
    if _LIBRARIES in kept:
        # An empty entry is the folder that a process works in; importing OpenCV adds one.
        kept[_LIBRARIES] = os.pathsep.join(filter(os.path.isabs, kept[_LIBRARIES].split(os.pathsep)))
    return kept | {
        "PATH": "",
        "HOME": str(folder),
        "TMPDIR": str(folder),
        "PYTHONPATH": os.pathsep.join(filter(None, [str(IMPORT_ROOT), os.environ.get("PYTHONPATH", "")])),
        "PYTHONUSERBASE": site.getuserbase(),
        "HDF5_PLUGIN_PRELOAD": "::",
        "HDF5_USE_FILE_LOCKING": "FALSE",
        "OMP_NUM_THREADS": "1",
    }


def serve(
    read: Callable[[Path, Sequence[str]], Mapping[str, Any]], libraries: Sequence[str] = (), space: int | None = None
) -> int:
    """What the child does: confine itself, read FILE, and write the arrays; returns the exit code.

    Args:
        read: makes arrays by name of the file and the arguments; what it raises is told in one line.
        libraries: imported before rights are given up, if they are there: some look for their parts with the help of programs.
        space: address space, bytes; by default what a sound file of this length needs.
    """
    import numpy as np

    source, out = Path(sys.argv[1]), sys.argv[2]
    prepare(libraries)
    limit_memory(source, space)
    with open(out, "wb") as stream:
        confine([source.parent])
        try:
            np.savez(stream, **read(source, sys.argv[3:]))
        except Exception as error:
            print(reason_of(error))
            return 1
    return 0


def reason_of(error: Exception) -> str:
    """What an error says, in one line, whatever a file has put into it."""
    return " ".join(str(error).split()) or type(error).__name__


def prepare(libraries: Sequence[str]) -> None:
    """End with bcid, and import libraries while they may still be looked for with the help of programs."""
    ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL, 0, 0, 0)
    for name in libraries:
        with suppress(ImportError):
            import_module(name)


def limit_memory(source: Path, space: int | None = None) -> None:
    """A damaged file may ask for any memory: it gets what a sound one of its length needs, at most half of the machine's."""
    most = _SPACE + _PER_BYTE * source.stat().st_size if space is None else space
    most = min(most, max(_SPACE, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2))
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_LONGEST_RESULT, _LONGEST_RESULT))


def confine(folders: Iterable[Path]) -> tuple[bool, bool]:
    """Give up, for good, all rights but to compute, to read below `folders` and where libraries are, and to write what is open.

    Returns whether Landlock holds, and whether the filter of system calls does. Without the latter an ordinary user's process
    can at least make no other; a limit of processes does not bind root.
    """
    # In this order: libseccomp is found with the help of a program.
    calls, files = compute_only(), read_only(folders)
    if not calls:
        resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))
    return files, calls
