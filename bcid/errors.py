"""Errors a user may meet, and the collector that reports all problems of a file at once.

Exit codes: 2 bad input, 3 the machine (disk, memory, a missing program), 4 the forward model could not be solved.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


class BcidError(Exception):
    """Base of every error that is the user's business: the command line prints its text, never a traceback."""

    exit_code = 1


class InputError(BcidError):
    """Input that cannot be used; the text names what, which value, what is allowed and what to do."""

    exit_code = 2


class MachineError(BcidError):
    """The machine cannot do it: a full disk, a file that cannot be written, a missing program."""

    exit_code = 3


SHORT_OF_MEMORY = (
    "out_of_memory: there is not enough memory; end other programs, use fewer ranks or a coarser level, "
    "and give the same command again: it goes on where it was"
)


class SolveError(BcidError):
    """The forward model has no acceptable solution; the text carries PETSc's reason in words."""

    exit_code = 4


def nearest(word: str, allowed: Iterable[str]) -> str:
    """A hint such as ``did you mean 'x'? known: a, b`` for a misspelt name."""
    known = [str(name) for name in allowed]
    close = difflib.get_close_matches(str(word), known, n=1)
    hint = f"did you mean '{close[0]}'? " if close else ""
    shown = ", ".join(known[:24]) + (", ..." if len(known) > 24 else "")
    return f"{hint}known: {shown}" if known else "none is defined"


@dataclass(frozen=True)
class Problem:
    """One thing wrong in a file: where it is and what to do about it."""

    file: str
    line: int | None
    text: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else self.file
        return f"{place}: {self.text}"


class Problems:
    """Collects the problems of an input so that they are reported together.

    More than `shown` problems are counted, not listed: a file with a wrong column has one problem per row.
    """

    def __init__(self, what: str, shown: int = 20) -> None:
        self.what = what
        self.shown = shown
        self.found: list[Problem] = []

    def add(self, file: str | Path, text: str, line: int | None = None) -> None:
        """Note a problem of `file` (at `line`, counted from 1)."""
        self.found.append(Problem(str(file), line, text))

    def raise_if_any(self) -> None:
        """Raise one `InputError` with every problem found so far."""
        if not self.found:
            return
        count = len(self.found)
        head = f"{self.what}: {count} problem{'s' if count > 1 else ''}"
        lines = [f"  {problem}" for problem in self.found[: self.shown]]
        if count > self.shown:
            lines.append(f"  ... and {count - self.shown} more")
        raise InputError("\n".join([head, *lines]))
