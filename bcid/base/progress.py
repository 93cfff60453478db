"""What a command says while it works, from rank 0 only: a bar on a terminal, lines in a log."""

from __future__ import annotations

import sys
import time
from shutil import get_terminal_size
from typing import Any, ClassVar, Protocol, TextIO

from bcid.base.visible import visible


class Progress(Protocol):
    """Receives what a long computation is doing; see `Silent`, `Lines` and `Bar`."""

    def say(self, text: str) -> None:
        """Say something that must be seen."""

    def step(self, work: str, done: float = 0, total: float = 0, note: str = "") -> None:
        """Say how far a piece of work is; may be dropped when another line was written just before.

        Args:
            work: the piece of work; another one begins with another name.
            done: how much of it is done.
            total: how much there is to do; 0 where that is not known.
            note: what was found so far.
        """


class Silent:
    """Says nothing: for scripts, and for every rank but 0."""

    def say(self, text: str) -> None:
        """Drop `text`."""

    def step(self, work: str, done: float = 0, total: float = 0, note: str = "") -> None:
        """Drop it."""


class Steps:
    """How far a part of a larger computation is; what the part has to say of itself is dropped."""

    def __init__(self, progress: Progress) -> None:
        self.step = progress.step

    def say(self, text: str) -> None:
        """Drop `text`."""


class _Clock:
    """When each piece of work began, and with how much of it done."""

    def __init__(self) -> None:
        self._begun: dict[str, tuple[float, float]] = {}
        self._last: dict[str, float] = {}

    def left(self, work: str, done: float, total: float) -> float | None:
        """Seconds that the rest will take if it goes on at the same pace; None while that cannot be said."""
        now = time.monotonic()
        if work not in self._begun or done < self._last[work]:
            self._begun[work] = now, done
        self._last[work] = done
        began, first = self._begun[work]
        made = done - first
        return (now - began) / made * (total - done) if made > 0 and total >= done else None


class Lines:
    """Writes plain lines, which survive `mpirun`, pipes and log files.

    Args:
        stream: where to write (standard error by default, so that results can be piped).
        every: seconds between two lines of `step`.
    """

    def __init__(self, stream: TextIO | None = None, every: float = 2.0) -> None:
        self.stream = stream or sys.stderr
        self.every = every
        self.start = time.monotonic()
        self.last = float("-inf")
        self._clock = _Clock()

    def say(self, text: str) -> None:
        """Write a line with the seconds since the start."""
        self.last = time.monotonic()
        print(f"[{self.last - self.start:6.1f} s] {visible(text)}", file=self.stream, flush=True)

    def step(self, work: str, done: float = 0, total: float = 0, note: str = "") -> None:
        """Write a line unless one was written less than `every` seconds ago."""
        left = self._clock.left(work, done, total)
        if time.monotonic() - self.last >= self.every:
            self.say(how_far(work, done, total, left) + (f"; {note}" if note else ""))


class Bar:
    """Shows a piece of work in the last line of a terminal, and writes what is said above it.

    Args:
        stream: the terminal (standard error by default).
    """

    shown: ClassVar[Bar | None] = None

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = stream or sys.stderr
        self.start = time.monotonic()
        self._clock = _Clock()
        self._bar: Any = None

    def say(self, text: str) -> None:
        """Write a line with the seconds since the start; the bar goes until the next step."""
        self.clear()
        print(f"[{time.monotonic() - self.start:6.1f} s] {visible(text)}", file=self.stream, flush=True)

    def step(self, work: str, done: float = 0, total: float = 0, note: str = "") -> None:
        """Show how far it is."""
        from tqdm import tqdm

        Bar.shown = self
        left = self._clock.left(work, done, total)
        text = how_far(work, done, total, left) + (f"; {note}" if note else "")
        bar = "|{bar:24}| " if total else ""
        if self._bar is None:
            self._bar = tqdm(total=1, file=self.stream, leave=False)
        # The name of a piece of work is not a format.
        self._bar.bar_format = bar + visible(text).replace("{", "{{").replace("}", "}}")
        self._bar.total, self._bar.n = total or None, min(done, total) if total else done
        # Of a terminal that does not tell its size this is 80.
        self._bar.ncols = get_terminal_size().columns - 1
        self._bar.refresh()

    def clear(self) -> None:
        """Take it from the terminal, until the next step."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def how_far(work: str, done: float, total: float, left: float | None) -> str:
    """How far a piece of work is, as "anchor sets of level 0: 43 of 256, about 5 s left"."""
    count = f": {done:.0f} of {total:.0f}" if total else f": {done:.0f} so far" if done else ""
    return work + count + (f", about {roughly(left)} left" if left else "")


def roughly(seconds: float) -> str:
    """Seconds as a person says them, as "5 s", "3 min" or "2 h 10 min"."""
    whole = max(1, round(seconds))
    if whole < 90:
        return f"{whole} s"
    minutes = round(whole / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


def progress_on(stream: TextIO | None = None) -> Progress:
    """A bar if the stream (standard error by default) is a terminal, else lines."""
    chosen = stream or sys.stderr
    return Bar(chosen) if chosen.isatty() else Lines(chosen)


def clear() -> None:
    """Take the bar from the terminal, before something else is written there."""
    if Bar.shown is not None:
        Bar.shown.clear()
