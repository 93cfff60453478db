"""F7: a temporary folder that is full, small, read-only or not there: exit code 3, one message that names it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from validation.reliability import ROOT, Reached
from validation.reliability.disk import command
from validation.reliability.inputs import small_scene

# Size of the temporary file system, what is done to it, and the exit code.
CASES: tuple[tuple[str, str, int], ...] = (
    ("4k", "small", 3),
    ("16k", "small", 3),
    ("64k", "small", 3),
    ("1m", "small", 3),
    ("64m", "full", 3),
    ("64m", "read-only", 3),
    ("64m", "missing", 3),
    ("64m", "small", 0),
)
# Mounts a file system in a namespace of its own, where no other process sees it, and runs a command with it as $TMPDIR.
_MOUNTED = """
import ctypes, os, subprocess, sys
place, size, state, command, libc = sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:], ctypes.CDLL(None)
if libc.mount(b"small", place.encode(), b"tmpfs", 0, f"size={size}".encode()):
    sys.exit(77)
if state == "full":
    with open(place + "/full", "wb", buffering=0) as stream:
        try:
            while stream.write(bytes(4096)) == 4096:
                pass
        except OSError:
            pass
if state == "read-only":
    libc.mount(b"small", place.encode(), b"tmpfs", 33, b"")
folder = place + "/nothing" if state == "missing" else place
sys.exit(subprocess.run(command, env=os.environ | {"TMPDIR": folder}).returncode)
"""
# As when it is filled by another program after the command has begun.
_LATER = "import sys, bcid.app.cli; bcid.app.cli.require = lambda: None; sys.exit(bcid.app.cli.main(sys.argv[1:]))"


def full(ranks: Sequence[int] = (1, 2), only: Sequence[tuple[str, str, int]] = CASES) -> Reached:
    """F7: identify of the small scene with each temporary folder, and with each that fills up after the start."""
    misses: list[str] = []
    tried = 0
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        folder = Path(name)
        scene, seen, place = small_scene(folder), folder / "seen", folder / "tmp"
        place.mkdir()
        motion = ("--anchors", "3,4", "--motion", "pull", "--level", "1", "--quiet")
        assert command("simulate", scene, *motion, "-o", seen)[0] == 0
        words = ["identify", str(scene), str(seen), "--level", "0", "--exhaustive", "yes", "--quiet", "--no-picture"]
        starts = [([sys.executable, "-m", "bcid"], 1), ([sys.executable, "-c", _LATER], 1)]
        starts += [(["mpirun", "-n", str(number), sys.executable, "-m", "bcid"], number) for number in ranks[1:]]
        for size, state, code in only:
            for start, number in starts:
                if _not_ours(start, number, state):
                    continue
                out = folder / f"run-{tried}"
                done = _run(place, size, state, [*start, *words, "-o", str(out)], folder / f"cache-{tried}")
                if done.returncode == 77 or "unshare" in done.stderr:
                    return Reached("", "no tmpfs can be mounted here", True)
                tried += 1
                # Less than what is asked for at the start may be enough.
                enough = _LATER in start and state == "small" and done.returncode == 0
                wrong = _wrong(done, 0 if enough else code, str(place))
                if wrong:
                    misses.append(f"{size} {state}, {' '.join(start)[:60]}: {wrong}")
    goal = "temporary folder full, read-only or missing: exit code 3, one message that names it; with room, the result"
    return Reached(goal, f"{tried} runs, {len(misses)} wrong", not misses, tuple(misses))


def _not_ours(start: Sequence[str], number: int, state: str) -> bool:
    """Open MPI and its launcher die by themselves of a folder that is not there or cannot be written, before bcid is asked."""
    return state in ("read-only", "missing") and (number > 1 or _LATER in start)


def _run(place: Path, size: str, state: str, words: list[str], cache: Path) -> subprocess.CompletedProcess[str]:
    unshared = ["unshare", "-rm", sys.executable, "-c", _MOUNTED, str(place), size, state, *words]
    # A cache of its own, so that forms are compiled.
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(ROOT)}
    return subprocess.run(unshared, capture_output=True, text=True, check=False, env=environment)


def _wrong(done: subprocess.CompletedProcess[str], code: int, place: str) -> str:
    said = [line for line in done.stderr.splitlines() if line.startswith("bcid: ")]
    if done.returncode != code or "Traceback" in done.stderr:
        return f"exit code {done.returncode}, {done.stderr[-300:]!r}"
    if code and (len(said) != 1 or f"temporary folder {place}" not in said[0] or "set TMPDIR" not in said[0]):
        return f"said {said}"
    return ""
