"""A time limit for a trial that is made in this process, as `validation.engine.workers` has one for child processes."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

# A trial that does not use its CPU seconds is waited for so many times the limit.
PATIENCE = 4
# So often, in s, a trial is told again that did not end.
_AGAIN = 5.0


def used_up(limit: float) -> str:
    """Why a trial was ended that has used so many CPU seconds."""
    return f"took more than {limit:.0f} CPU s"


def never_done(limit: float) -> str:
    """Why a trial was ended that has not, and was waited for."""
    return f"was not done after {PATIENCE * limit:.0f} s"


class OutOfTime(BaseException):
    """A trial has used up its time. No `Exception`: whatever a trial forgives, it does not forgive this."""


@contextmanager
def limited(seconds: float | None) -> Iterator[None]:
    """Raise `OutOfTime` in the work below once it has used so many CPU seconds, or `PATIENCE` times as many by the clock.

    Only in the main thread. Code that is not Python is not interrupted: it is told when it returns.
    """
    if seconds is None:
        yield
        return

    def cpu(*_: object) -> None:
        raise OutOfTime(used_up(seconds))

    def clock(*_: object) -> None:
        raise OutOfTime(never_done(seconds))

    before = signal.signal(signal.SIGPROF, cpu), signal.signal(signal.SIGALRM, clock)
    signal.setitimer(signal.ITIMER_PROF, seconds, _AGAIN)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE * seconds, _AGAIN)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGPROF, before[0])
        signal.signal(signal.SIGALRM, before[1])
