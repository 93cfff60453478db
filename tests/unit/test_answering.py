"""A confined process that answers requests: what it may send back, how it ends, and what is left of it."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bcid.base.answering import Answering
from bcid.base.errors import InputError

ROOT = Path(__file__).resolve().parents[2]

_ECHO = """
import sys, time
import numpy as np
from bcid.base.answering import answer

def reply(request):
    print("chatter of a library")
    if request == b"sleep":
        time.sleep(600)
    if not request:
        raise ValueError("is empty")
    return np.frombuffer(request, "u1")[None]

sys.exit(answer(reply))
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a module `other` that a process can run."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path / "other.py"


def test_requests_are_answered_one_after_the_other(module: Path) -> None:
    module.write_text(_ECHO, encoding="utf-8")
    other = Answering("other")
    for request in (b"a", bytes(3_000_000), b"bc"):
        np.testing.assert_array_equal(other.ask(request, 60), np.frombuffer(request, "u1")[None])
    with pytest.raises(InputError, match=r"^is empty$"):
        other.ask(b"", 60)
    assert other.ask(b"d", 60).tolist() == [[100]]
    other.close()


_HEADS = {
    "kind": (7, 1, 1, 1),
    "bytes of an item": (1, 4, 1, 1),
    "length": (1, 1, 10**6, 10**6),
    "sign": (1, 1, 2**63, 2),
    "emptiness": (1, 1, 0, 5),
    "reason": (0, 1, 10**12, 1),
    "end": (1, 1, 5, 5),
}


@pytest.mark.parametrize("what", _HEADS)
def test_answer_of_a_process_that_was_taken_over_is_refused(module: Path, what: str) -> None:
    head = struct.pack("<BB6xQQ", *_HEADS[what])
    module.write_text(f"import sys\nsys.stdout.buffer.write({head!r})\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"the reader died, code (0|-9);"):
        Answering("other").ask(b"a", 60)


@pytest.mark.parametrize("length", [1, 10_000_000])
def test_process_that_does_not_answer_in_time_is_ended(module: Path, length: int) -> None:
    """Whether it takes the request or not."""
    module.write_text("import time\ntime.sleep(600)\n", encoding="utf-8")
    with pytest.raises(InputError, match="reading took more than 1 s"):
        Answering("other").ask(bytes(length), 1.0)


_SIGNALLED = """
import signal
from bcid.base.answering import Answering

signal.signal(signal.SIGPIPE, signal.SIG_DFL)
try:
    Answering("other").ask(bytes(10_000_000), 60.0)
except Exception as error:
    print(error)
"""


def test_process_that_dies_of_its_request_leaves_the_one_that_asks_alive(module: Path) -> None:
    """Where a broken pipe ends a process, as it does when PETSc has been loaded."""
    module.write_text("import sys\nsys.stdin.buffer.read(100_000)\n", encoding="utf-8")
    done = subprocess.run([sys.executable, "-c", _SIGNALLED], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0
    assert "cannot be read: the reader died, code " in done.stdout


@pytest.mark.parametrize("how", ["closed", "forgotten"])
def test_process_is_gone_when_nobody_asks(module: Path, how: str) -> None:
    module.write_text(_ECHO, encoding="utf-8")
    other = Answering("other")
    other.ask(b"a", 60)
    assert other._child is not None
    number = other._child.pid
    if how == "closed":
        other.close()
    else:
        del other
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


_KILLED = """
import os, threading
from bcid.base.answering import Answering

other = Answering("other")
other.ask(b"a", 60)
print(other._child.pid, flush=True)
threading.Timer(0.2, os.kill, (os.getpid(), 9)).start()
other.ask(b"sleep", 600)
"""


def test_process_ends_with_the_one_that_asks(module: Path) -> None:
    """Killed, it can close nothing; what reads may hang."""
    module.write_text(_ECHO, encoding="utf-8")
    done = subprocess.run([sys.executable, "-c", _KILLED], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == -9
    number = int(done.stdout)
    for _ in range(200):
        if not _alive(number):
            break
        time.sleep(0.05)
    assert not _alive(number)


def _alive(number: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        state = Path(f"/proc/{number}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"
