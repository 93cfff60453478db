"""Files inside a folder that others may have made: regular files alone, of a size that is declared, and nothing behind links."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from bcid.base.errors import InputError

# Most bytes that are read of a file, by the ending of its name; other files are texts.
_LONGEST = {".json": 100_000_000, ".nc": 2_000_000_000, ".npz": 2_000_000_000, ".png": 50_000_000}
_LONGEST_TEXT = 10_000_000
# A FIFO is not waited for, and no link is followed.
_FLAGS = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def read_inside(folder: Path, name: str, longest: int | None = None) -> bytes:
    """Content of the file `name` of a folder, which may stand in folders inside it.

    Args:
        folder: the folder, as the user names it.
        name: of the file, relative to the folder, with slashes.
        longest: most bytes that are read; by default what its ending allows.

    Raises:
        InputError: it is missing, no regular file, too long or cannot be read, or a link stands in its path.
    """
    path = folder / name
    most = longest or _LONGEST.get(path.suffix, _LONGEST_TEXT)
    parts = PurePosixPath(name).parts
    if not parts or ".." in parts or PurePosixPath(name).is_absolute():
        raise InputError(f"{name!r}: is not the name of a file inside {folder}; expected a relative name without '..'")
    try:
        with _opened(folder, parts) as file:
            return _content(file, path, most)
    except FileNotFoundError:
        raise InputError(f"{path}: is missing") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {_reason(error)}; expected a regular file, no link") from None


def refuse_links(folder: Path) -> None:
    """Refuse a folder in which anything but regular files and folders stands.

    Raises:
        InputError: the folder, or something in it, is a link, a FIFO or a device.
    """
    for path in (folder, *folder.rglob("*")):
        if os.path.lexists(path) and stat.S_IFMT(path.lstat().st_mode) not in (stat.S_IFREG, stat.S_IFDIR):
            raise InputError(f"{path}: is a link, a FIFO or a device; remove it: only regular files are read here")


@contextmanager
def _opened(folder: Path, parts: tuple[str, ...]) -> Iterator[int]:
    """The descriptor of a file, opened folder by folder, so that no link on the way is followed."""
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        for number, part in enumerate(parts, 1):
            kind = os.O_DIRECTORY if number < len(parts) else 0
            inner = os.open(part, _FLAGS | kind, dir_fd=held)
            os.close(held)
            held = inner
        yield held
    finally:
        os.close(held)


def _content(file: int, path: Path, most: int) -> bytes:
    about = os.fstat(file)
    if not stat.S_ISREG(about.st_mode):
        raise InputError(f"{path}: is no regular file; expected one")
    if about.st_size > most:
        raise InputError(f"{path}: has {about.st_size / 1e6:.6g} MB, more than the {most / 1e6:g} MB that are read")
    with open(file, "rb", closefd=False) as stream:
        content = stream.read(most + 1)
    if len(content) > most:
        raise InputError(f"{path}: is longer than the {most / 1e6:g} MB that are read")
    return content


def _reason(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)
