"""What a command says while it works: one line now and then, from rank 0 only."""

from __future__ import annotations

import sys
import time
from typing import Protocol, TextIO


class Progress(Protocol):
    """Receives what a long computation is doing; see `Silent` and `Lines`."""

    def say(self, text: str) -> None:
        """Say something that must be seen."""

    def step(self, text: str) -> None:
        """Say how far it is; may be dropped when another line was written just before."""


class Silent:
    """Says nothing: for scripts, and for every rank but 0."""

    def say(self, text: str) -> None:
        """Drop `text`."""

    def step(self, text: str) -> None:
        """Drop `text`."""


class Lines:
    """Writes plain lines, which survive `mpirun`, pipes and log files.

    Args:
        stream: where to write (standard error by default, so that results can be piped).
        every: seconds between two `step` lines.
    """

    def __init__(self, stream: TextIO | None = None, every: float = 2.0) -> None:
        self.stream = stream or sys.stderr
        self.every = every
        self.start = time.monotonic()
        self.last = float("-inf")

    def say(self, text: str) -> None:
        """Write a line with the seconds since the start."""
        self.last = time.monotonic()
        print(f"[{self.last - self.start:6.1f} s] {text}", file=self.stream, flush=True)

    def step(self, text: str) -> None:
        """Write a line unless one was written less than `every` seconds ago."""
        if time.monotonic() - self.last >= self.every:
            self.say(text)
