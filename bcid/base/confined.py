"""Reading the files of others in a process of its own, which can start nothing and open nothing else.

Readers of meshes and recordings open side files of their own accord, follow references in a file, and die of damaged
ones. So a file is copied under a neutral name into an empty folder, and read there by a child process with next to no
environment, limited time and limited memory. Where the kernel has Landlock (Linux 5.13 or newer), the child gives up all
rights but to read that folder and the installed libraries: it can execute nothing and write nothing, whatever its reader does.
"""

from __future__ import annotations

import ctypes
import os
import resource
import shutil
import site
import struct
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from bcid.base.errors import InputError
from bcid.base.scratch import require, temporary_folder
from bcid.base.shipped import IMPORT_ROOT

# The folder that holds the package.

# What a child is given of the environment: where its libraries are, and how it writes text. Nothing that loads plugins.
_KEPT = ("LD_LIBRARY_PATH", "PYTHONHOME", "LANG", "LC_ALL", "LC_CTYPE")
_COVERAGE = "COVERAGE_"
# Of a child that reads a file, bytes of address space, and how much more a byte of the file may take.
_SPACE = 2_000_000_000
_PER_BYTE = 100
# Longest file that is copied, bytes: a mesh of as many elements as can be solved on is a quarter of it.
_LONGEST_FILE = 2_000_000_000
# Longest reason of a child that is passed on.
_LONGEST = 300
# System calls and constants of Landlock (Linux, uapi/linux/landlock.h); the numbers are the same on all architectures but Alpha.
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_VERSION, _PATH_BENEATH = 1, 1
_READ_FILE, _READ_FOLDER = 1 << 2, 1 << 3
# Rights over files and folders that each version of Landlock knows, and over TCP.
_RIGHTS = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 4: (1 << 15) - 1, 5: (1 << 16) - 1}
_TCP_SINCE, _TCP = 4, 0b11
_NO_NEW_PRIVILEGES = 38


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
    # Not above: `bcid doctor` asks for Landlock, and works without numpy.
    import numpy as np

    with temporary_folder("bcid-read-") as folder:
        out = folder / "out.npz"
        file = source.resolve() if in_place else _copied(source, beside, folder / "in")
        if check is not None:
            check(file)
        command = [sys.executable, "-P", "-m", module, str(file), str(out), *arguments]
        try:
            child = subprocess.run(
                command,
                env=_environment(folder),
                cwd=folder,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"reading took more than {seconds:.0f} s") from None
        if child.returncode != 0:
            require()
            said = (child.stdout + child.stderr).decode("utf-8", "replace").strip().splitlines()
            reason = said[-1] if said else f"the reader died with code {child.returncode}"
            raise InputError(reason.replace(str(file), source.name)[:_LONGEST])
        with np.load(out, allow_pickle=False) as data:
            return {key: data[key] for key in data.files}


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


def _environment(folder: Path) -> dict[str, str]:
    """Of a child: no program is found by name, nothing is configured from the user's home, HDF5 loads no plugins."""
    kept = {name: value for name, value in os.environ.items() if name in _KEPT or name.startswith(_COVERAGE)}
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
    for name in libraries:
        with suppress(ImportError):
            import_module(name)
    limit_memory(source, space)
    with open(out, "wb") as stream:
        confine([source.parent])
        try:
            np.savez(stream, **read(source, sys.argv[3:]))
        except Exception as error:
            print(str(error).strip().replace("\n", " ") or type(error).__name__)
            return 1
    return 0


def limit_memory(source: Path, space: int | None = None) -> None:
    """A damaged file may ask for any memory: it gets what a sound one of its length needs, at most half of the machine's."""
    most = _SPACE + _PER_BYTE * source.stat().st_size if space is None else space
    most = min(most, max(_SPACE, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2))
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def confine(folders: Iterable[Path]) -> bool:
    """Give up, for good, every right over files but to read below `folders` and where libraries are; False without Landlock.

    Files that are open stay open. See the kernel's documentation, userspace-api/landlock.
    """
    version = landlock()
    if version == 0:
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    known = version >= _TCP_SINCE
    handled = (ctypes.c_uint64 * 2)(_RIGHTS[min(version, max(_RIGHTS))], _TCP if known else 0)
    rules = libc.syscall(_CREATE_RULESET, ctypes.byref(handled), ctypes.c_size_t(16 if known else 8), 0)
    for path in {*folders, *_libraries()}:
        _allow_reading(libc, rules, path)
    libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    done = libc.syscall(_RESTRICT_SELF, rules, 0) == 0
    os.close(rules)
    return done


def _allow_reading(libc: ctypes.CDLL, rules: int, path: Path) -> None:
    rights = _READ_FILE | (_READ_FOLDER if path.is_dir() else 0)
    opened = os.open(path, os.O_PATH | os.O_CLOEXEC)
    rule = ctypes.create_string_buffer(struct.pack("=QI", rights, opened))
    libc.syscall(_ADD_RULE, rules, _PATH_BENEATH, ctypes.byref(rule), 0)
    os.close(opened)


def landlock() -> int:
    """Version of Landlock that the kernel offers; 0 for none."""
    if sys.platform != "linux":
        return 0
    return max(0, int(ctypes.CDLL(None).syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), _VERSION)))


def _libraries() -> set[Path]:
    """Where the interpreter, installed packages and the system's libraries are; not where bcid lies, which is loaded by then."""
    found = {"/usr", "/lib", "/lib64", "/etc/ld.so.cache", sys.prefix, sys.base_prefix, *sysconfig.get_paths().values()}
    found |= {path for path in sys.path if Path(path) != IMPORT_ROOT}
    found |= set(os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)) - {""}
    return {Path(path) for path in found if Path(path).exists()}
