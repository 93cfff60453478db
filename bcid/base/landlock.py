"""Landlock: a process gives up, for good, every right over files but to read some folders, and more where the kernel is newer.

From Linux 5.13 on all writing and executing, from 6.7 on TCP, from 6.12 on signals to others and abstract UNIX sockets. See the
kernel's documentation, userspace-api/landlock.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path

from bcid.base.shipped import IMPORT_ROOT

# System calls and constants of Landlock (Linux, uapi/linux/landlock.h); the numbers are the same on all architectures but Alpha.
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_VERSION, _PATH_BENEATH = 1, 1
_READ_FILE, _READ_FOLDER = 1 << 2, 1 << 3
# Rights over files and folders that each version of Landlock knows; over TCP; to signal others and to use abstract sockets.
_RIGHTS = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 4: (1 << 15) - 1, 5: (1 << 16) - 1}
_TCP_SINCE, _TCP = 4, 0b11
_SCOPED_SINCE, _SCOPED = 6, 0b11
_NO_NEW_PRIVILEGES = 38


def read_only(folders: Iterable[Path]) -> bool:
    """Keep no right over files but to read below `folders` and where libraries are; False without Landlock.

    Files that are open stay open.
    """
    version = landlock()
    if version == 0:
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    handled = [_RIGHTS[min(version, max(_RIGHTS))]]
    handled += [_TCP] if version >= _TCP_SINCE else []
    handled += [_SCOPED] if version >= _SCOPED_SINCE else []
    attributes = (ctypes.c_uint64 * len(handled))(*handled)
    rules = libc.syscall(_CREATE_RULESET, ctypes.byref(attributes), ctypes.c_size_t(8 * len(handled)), 0)
    for path in {*folders, *_libraries()}:
        _allow_reading(libc, rules, path)
    libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    done = libc.syscall(_RESTRICT_SELF, rules, 0) == 0
    os.close(rules)
    return done


def landlock() -> int:
    """Version of Landlock that the kernel offers; 0 for none."""
    if sys.platform != "linux":
        return 0
    return max(0, int(ctypes.CDLL(None).syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), _VERSION)))


def _allow_reading(libc: ctypes.CDLL, rules: int, path: Path) -> None:
    rights = _READ_FILE | (_READ_FOLDER if path.is_dir() else 0)
    try:
        opened = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except PermissionError:
        # What may not be reached is not read in any case.
        return
    rule = ctypes.create_string_buffer(struct.pack("=QI", rights, opened))
    libc.syscall(_ADD_RULE, rules, _PATH_BENEATH, ctypes.byref(rule), 0)
    os.close(opened)


def _libraries() -> set[Path]:
    """Where the interpreter, installed packages and the system's libraries are; not where bcid lies, which is loaded by then."""
    found = {"/usr", "/lib", "/lib64", "/etc/ld.so.cache", sys.prefix, sys.base_prefix, *sysconfig.get_paths().values()}
    found |= {path for path in sys.path if Path(path) != IMPORT_ROOT}
    found |= set(os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)) - {""}
    return {Path(path) for path in found if os.path.exists(path)}
