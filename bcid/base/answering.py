"""A confined process that answers one request after the other, through pipes: for what comes in many pieces, as films do.

Requests are bytes; an answer is an array of rows and columns of whole numbers, or the reason why there is none.
"""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Timer
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import confine, environment_of_child, limit_memory, prepare, reason_of
from bcid.base.errors import InputError

# Before a request its length; before an answer what it is, bytes of an item, rows, columns.
_LENGTH, _HEAD = struct.Struct("<Q"), struct.Struct("<BB6xQQ")
_REFUSED, _ARRAY = 0, 1
_TYPES: dict[int, np.dtype[Any]] = {size: np.dtype(f"<u{size}") for size in (1, 2, 8)}
# Bytes of an answer: as many as an image may have. Bytes of a reason.
_LARGEST, _LONGEST_REASON = 1_000_000_000, 10_000
# Address space of the process, bytes: a file, its image, and threads of a decoder.
_SPACE = 4_000_000_000
# Starts of the process until nothing more is asked.
_MOST_STARTS = 4


class Answering:
    """A process that runs ``python -m MODULE ARGUMENT ...``, where MODULE calls `answer`.

    It starts at the first request, and again after it has died, up to three times.

    Args:
        module: name of the module.
        arguments: passed on.
    """

    def __init__(self, module: str, arguments: Sequence[str] = ()) -> None:
        self._command = [sys.executable, "-P", "-m", module, *arguments]
        self._child: subprocess.Popen[bytes] | None = None
        self._end: Callable[[], object] = lambda: None
        self._starts = 0

    def ask(self, request: bytes, seconds: float) -> NDArray[Any]:
        """The answer to a request, shape (rows, columns), of 8, 16 or 64 bits without sign.

        Args:
            request: passed on.
            seconds: after which the process is ended.

        Raises:
            InputError: the process refuses the request, dies, or takes too long; the text is the reason, without a name.
        """
        child, start = self._running(), time.monotonic()
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            with _limited(child, seconds):
                send(child.stdin.fileno(), _LENGTH.pack(len(request)) + request)
                answer = _received(child.stdout)
        except (OSError, EOFError, ValueError):
            self.close()
            late = time.monotonic() - start >= seconds
            reason = f"reading took more than {seconds:.0f} s" if late else f"the reader died, code {child.returncode}"
            raise InputError(f"cannot be read: {reason}; is it whole? Copy it again") from None
        except BaseException:
            # What is still in the pipes would be taken for the next answer.
            self.close()
            raise
        if isinstance(answer, str):
            raise InputError(answer)
        return answer

    def close(self) -> None:
        """End the process."""
        self._end()
        self._child = None

    def _running(self) -> subprocess.Popen[bytes]:
        if self._child is None:
            if self._starts == _MOST_STARTS:
                raise InputError(f"is not read: the reader had to be started {self._starts} times before")
            self._starts += 1
            self._child = subprocess.Popen(
                self._command,
                env=environment_of_child(Path(os.devnull)),
                cwd="/",
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            self._end = weakref.finalize(self, _ended, self._child)
        return self._child


@contextmanager
def _limited(child: subprocess.Popen[bytes], seconds: float) -> Iterator[None]:
    """End a process unless what is done inside ends in time."""
    timer = Timer(seconds, _kill, (child,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()


def _kill(child: subprocess.Popen[bytes]) -> None:
    with suppress(OSError):
        os.killpg(child.pid, signal.SIGKILL)


def _ended(child: subprocess.Popen[bytes]) -> None:
    _kill(child)
    child.wait()
    for stream in (child.stdin, child.stdout):
        if stream is not None:
            with suppress(OSError):
                stream.close()


def _received(stream: IO[bytes]) -> NDArray[Any] | str:
    """An answer, or the reason why there is none; it may come from a process that was taken over."""
    kind, size, rows, columns = _HEAD.unpack(_exactly(stream, _HEAD.size))
    if kind == _REFUSED and rows <= _LONGEST_REASON:
        return _exactly(stream, rows).decode("utf-8", "replace")
    if kind != _ARRAY or size not in _TYPES or not 0 < rows * columns * size <= _LARGEST:
        raise ValueError("no answer")
    array = np.empty((rows, columns), _TYPES[size])
    if stream.readinto(array) != array.nbytes:  # type: ignore[attr-defined]
        raise EOFError
    return array


def _exactly(stream: IO[bytes], length: int) -> bytes:
    content = stream.read(length)
    if len(content) != length:
        raise EOFError
    return content


def answer(reply: Callable[[bytes], NDArray[Any]], libraries: Sequence[str] = (), files: Iterable[Path] = ()) -> int:
    """What the process does: confine itself, and answer until nobody asks; returns the exit code.

    Args:
        reply: makes an array of two dimensions of a request; what it raises is told in one line.
        libraries: imported before rights are given up, if they are there.
        files: that may be read, besides libraries.
    """
    prepare(libraries)
    answers = os.fdopen(os.dup(1), "wb")
    # What a library prints is no answer.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    limit_memory(Path(os.devnull), _SPACE)
    confine(files)
    while head := sys.stdin.buffer.read(_LENGTH.size):
        try:
            found = np.ascontiguousarray(reply(sys.stdin.buffer.read(*_LENGTH.unpack(head))))
            said = _HEAD.pack(_ARRAY, found.itemsize, *found.shape)
            content = found.data.cast("B")
        except Exception as error:
            reason = reason_of(error).encode()[:_LONGEST_REASON]
            said, content = _HEAD.pack(_REFUSED, 1, len(reason), 1), memoryview(reason)
        answers.write(said)
        answers.write(content)
        answers.flush()
    return 0


def send(pipe: int, content: bytes) -> None:
    """Write all of some bytes to a pipe, by its descriptor; from any thread.

    The kernel also sends a signal where nobody reads, at which PETSc would end this process: it is held back.

    Raises:
        OSError: nobody reads it.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    try:
        rest = memoryview(content)
        while rest:
            rest = rest[os.write(pipe, rest) :]
    finally:
        if signal.SIGPIPE not in before:
            signal.sigtimedwait({signal.SIGPIPE}, 0)
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
