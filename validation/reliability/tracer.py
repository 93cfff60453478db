"""What a process and its children open, execute, write and connect to, as strace tells it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

_STARTS = ("execve", "execveat")
_CALLS = (
    *_STARTS,
    "open",
    "openat",
    "openat2",
    "creat",
    "mkdir",
    "mkdirat",
    "rename",
    "renameat",
    "renameat2",
    "unlink",
    "unlinkat",
)
_CALLS += ("symlink", "symlinkat", "link", "linkat", "connect")
_LINE = re.compile(r"^(\d+) +(?:<\.\.\. )?(\w+)(\(| resumed>)(.*)$")
_TEXT = re.compile(r'"((?:[^"\\]|\\.)*)"')
_BASE = re.compile(r"^(?:AT_FDCWD|\d+)<([^>]*)>, ")
_RESULT = re.compile(r"\) += (-?\d+|\?)")


@dataclass(frozen=True)
class Event:
    """One system call.

    Attributes:
        process: its number.
        call: "open" (for reading), "write" (anything that changes files), "execute" or "connect".
        path: absolute.
        words: of the command, of an execution.
        done: whether it succeeded.
    """

    process: int
    call: str
    path: str
    words: tuple[str, ...]
    done: bool


def traced(command: Sequence[str], log: Path, environment: Mapping[str, str]) -> tuple[list[Event], str] | None:
    """Run a command under strace; what it did, and what it printed. None where there is no strace."""
    program = shutil.which("strace")
    if program is None:
        return None
    words = [
        program,
        "-f",
        "-qq",
        "-y",
        "-s",
        "4096",
        "-e",
        f"trace={','.join(_CALLS)}",
        "-e",
        "signal=none",
        "-o",
        str(log),
        *command,
    ]
    done = subprocess.run(words, env=dict(environment), capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise AssertionError(f"{command[:4]} under strace: code {done.returncode}, {done.stderr[-1500:]}")
    return events(log.read_text(encoding="utf-8", errors="replace").splitlines()), done.stdout


def events(lines: Sequence[str]) -> list[Event]:
    """The events of a log of ``strace -f``."""
    found: list[Event] = []
    begun: dict[tuple[int, str], str] = {}
    for line in lines:
        match = _LINE.match(line)
        if not match:
            continue
        process, call, kind, rest = int(match[1]), match[2], match[3], match[4]
        if kind != "(":
            rest = begun.pop((process, call), "") + rest
        elif rest.endswith("<unfinished ...>"):
            begun[process, call] = rest
            continue
        found.append(_event(process, call, rest))
    return found


def _event(process: int, call: str, rest: str) -> Event:
    texts = [text.encode("latin-1", "replace").decode("unicode_escape", "replace") for text in _TEXT.findall(rest)]
    result, base = _RESULT.search(rest), _BASE.match(rest)
    done = result is not None and result[1] != "?" and int(result[1]) >= 0
    if call in _STARTS:
        return Event(process, "execute", texts[0] if texts else "", tuple(texts[1:]), done)
    if call == "connect":
        return Event(process, "connect", rest.split("}")[0], (), done)
    opens = call in ("open", "openat", "openat2")
    writes = not opens or re.search(r"O_(WRONLY|RDWR|CREAT|TRUNC)", rest) is not None
    named = (texts or [""])[-1 if not opens else 0]
    path = os.path.normpath(os.path.join(base[1] if base else "/", named))
    return Event(process, "write" if writes else "open", path, (), done)
