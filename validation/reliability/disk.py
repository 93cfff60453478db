"""F3: a disk that is full, read-only or broken from the n-th write on, for every n; and a real file system that is full."""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from bcid.app import cli
from bcid.base.errors import BcidError
from bcid.base.run_folder import RunFolder
from validation.reliability import Reached
from validation.reliability.writers import Writer, calibrating, others, solving

ERRORS = (errno.ENOSPC, errno.EIO, errno.EROFS)
_FIRST = 5
_CHANGES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir")


class Disk:
    """Fails whatever changes files below a folder, from the n-th change on, in this process.

    Attributes:
        folder: where it fails; None: nowhere.
        left: changes until it fails.
        error: what it fails with (errno).
    """

    def __init__(self) -> None:
        self.folder: Path | None = None
        self.left, self.made, self.error = 0, 0, errno.ENOSPC
        sys.addaudithook(self._seen)

    def _seen(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.folder is None or not (event == "open" or event in _CHANGES):
            return
        if event == "open":
            flags = arguments[2] if isinstance(arguments[2], int) else 0
            mode = str(arguments[1] or "r")
            if not (flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) or set(mode) & set("wax+")):
                return
        if not isinstance(arguments[0], str | os.PathLike) or self.folder not in Path(arguments[0]).resolve().parents:
            return
        self.made += 1
        self.left -= 1
        if self.left < 0:
            raise OSError(self.error, os.strerror(self.error))

    @contextlib.contextmanager
    def failing(self, folder: Path, after: int, error: int) -> Iterator[None]:
        """Let so many changes below `folder` pass, and fail all that follow."""
        self.folder, self.left, self.made, self.error = folder.resolve(), after, 0, error
        try:
            yield
        finally:
            self.folder = None


_disks: list[Disk] = []


def disk() -> Disk:
    """The one of this process: an audit hook cannot be taken away again."""
    if not _disks:
        _disks.append(Disk())
    return _disks[0]


def command(*arguments: object) -> tuple[int, str]:
    """Exit code and standard error of a command of bcid, run in this process."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            code = cli.main([str(argument) for argument in arguments])
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return code, said.getvalue()


def sound(folder: Path) -> str:
    """What is wrong with what a failed command has left in a run folder; "" if nothing is."""
    if not (folder / "run.json").exists():
        return ""
    try:
        RunFolder.open(folder)
        # A run that has not ended lists no files yet, but what is there must be whole.
        for file in folder.glob("*.json"):
            json.loads(file.read_bytes())
        for file in folder.glob("*.nc"):
            with xr.open_dataset(file, engine="scipy") as data:
                data.load()
    except (BcidError, OSError, ValueError) as error:
        return str(error)
    return ""


def wrong(code: int, said: str) -> str:
    """What is wrong with how a command failed; "" if nothing is."""
    lines = [line for line in said.splitlines() if line.strip()]
    if code != 3 or "Traceback" in said:
        return f"exit code {code}, {said[-300:]!r}"
    return "" if len(lines) == 1 and "cannot be written" in said else f"not one message: {said!r}"


def failures(count: int = 0, seed: int = 0, only: Sequence[int] = ERRORS) -> Reached:
    """F3: commands that write, on a disk that fails from the n-th change on: `count` values of n, or all (0), and each error."""
    misses: list[str] = []
    tried = 0
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        folder = Path(name)
        simulate, identify, calibrate = *solving(folder), calibrating(folder)
        made = folder / "seen", folder / "run", folder / "calibrated"
        for writer, target in zip((simulate, identify, calibrate), made, strict=True):
            code, said = command(*writer.words, target)
            assert code == 0, said
        writers = [simulate, identify, calibrate, *others(folder, *made[1:])]
        for writer in writers:
            out = folder / f"out-{writer.words[0]}"
            out.mkdir()
            for error, n, fault in _each(writer, out, count, only):
                tried += 1
                if fault:
                    misses.append(f"{writer.name}, {errno.errorcode[error]} from change {n}: {fault}")
        full = [on_tmpfs(writer, folder / "small") for writer in ([identify] if count else writers)]
        misses += filter(None, full)
        tmpfs = (
            "no tmpfs can be mounted here" if None in full else "a full tmpfs, and then one with more space, besides"
        )
        text = f"{tried} failures of {len(writers)} commands, from the first change of a file to the last; {tmpfs}"
    goal = "disk full, read-only, I/O error: one message, exit code 3, what was stored opens, resume works"
    return Reached(goal, text, not misses, tuple(misses))


def _each(writer: Writer, out: Path, count: int, only: Sequence[int]) -> Iterator[tuple[int, int, str]]:
    """Errors, changes from which on the disk fails with them, and what is wrong with how the command fails then."""
    total = _changes(writer, out)
    right = writer.read(out / f"right{writer.end}")
    # The first ones of a run make the folder, its lock and its record.
    few = {*range(_FIRST if writer.goes_on else 1), *(round(i * (total - 1) / max(count - 1, 1)) for i in range(count))}
    chosen = sorted(n for n in few if n < total) if count else range(total)
    for error in only:
        for n in chosen:
            target = out / f"{error}-{n}{writer.end}"
            yield error, n, _one(writer, target, out, n, error, right)


def _changes(writer: Writer, out: Path) -> int:
    """How many changes of files a command makes."""
    with disk().failing(out, 10**9, 0):
        code, said = command(*writer.words, out / f"right{writer.end}")
    assert code == 0, said
    return disk().made


def _one(writer: Writer, target: Path, out: Path, n: int, error: int, right: bytes) -> str:
    with disk().failing(out, n, error):
        code, said = command(*writer.words, target)
    if code == 0 and not said and writer.read(target) == right:
        # What failed was to remove what is needed no more.
        return ""
    fault = wrong(code, said) or (sound(target) if writer.goes_on else _stays(target))
    if fault:
        return fault
    code, said = command(*writer.words, target)
    if code != 0:
        return f"does not go on: exit code {code}, {said[-300:]!r}"
    return "" if writer.read(target) == right else "goes on to another result"


def _stays(target: Path) -> str:
    return f"{target.name} stays" if target.exists() else ""


_MOUNTED = """
import ctypes, subprocess, sys
place, command, libc = sys.argv[1], sys.argv[2:], ctypes.CDLL(None)
if libc.mount(b"small", place.encode(), b"tmpfs", 0, b"size=4k"):
    sys.exit(77)
print("code", subprocess.run(command).returncode, flush=True)
libc.mount(b"small", place.encode(), b"tmpfs", 32, b"size=64m")
print("code", subprocess.run(command).returncode, flush=True)
"""


def on_tmpfs(writer: Writer, place: Path) -> str | None:
    """What is wrong with a command on a real file system of 4 KiB, and then with more space; None where none can be mounted."""
    place.mkdir(exist_ok=True)
    words = [sys.executable, "-m", "bcid", *map(str, writer.words), str(place / f"made{writer.end}")]
    unshared = ["unshare", "-rm", sys.executable, "-c", _MOUNTED, str(place), *words]
    done = subprocess.run(unshared, capture_output=True, text=True, check=False)
    if done.returncode == 77 or "unshare" in done.stderr:
        return None
    codes = [line for line in done.stdout.splitlines() if line.startswith("code")]
    if codes != ["code 3", "code 0"] or done.stderr.count("bcid:") != 1 or "Traceback" in done.stderr:
        return f"{writer.name} on a full tmpfs: {done.stdout[-500:]} {done.stderr[-500:]}"
    return ""
