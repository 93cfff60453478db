"""Writing to a process that may have ended."""

from __future__ import annotations

import os
import signal


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
