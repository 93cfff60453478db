"""Errors a user may meet, and the collector that reports all problems of a file at once.

Exit codes: 2 bad input, 3 the machine (disk, memory, a missing program), 4 the forward model could not be solved.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from bcid.base.visible import visible

# What is to be done where a folder cannot be written.
_REMEDIES = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "free some space or choose another folder"),
    errno.EROFS: "choose a folder of a file system that is not mounted read-only",
    **dict.fromkeys((errno.EACCES, errno.EPERM), "choose a folder that you may write to"),
}
# What a message quotes of the input is cut to so many characters in a line, and so many lines.
_WIDEST, _MOST_LINES = 700, 60
# A name that is longer is nobody's misspelling, and so many names are looked through for the one that was meant.
_LONGEST_NAME, _LOOKED_THROUGH = 64, 1000


class BcidError(Exception):
    """Base of every error that is the user's business: the command line prints its text, never a traceback."""

    exit_code = 1

    def __init__(self, text: object = "") -> None:
        super().__init__(bounded(visible(text)))


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


def unwritable(path: Path, error: OSError) -> MachineError:
    """That a file or folder cannot be written, why, and what to do about it."""
    remedy = _REMEDIES.get(error.errno or 0, "choose another folder")
    return MachineError(f"{path}: cannot be written: {error.strerror or error}; {remedy}")


class SolveError(BcidError):
    """The forward model has no acceptable solution; the text carries PETSc's reason in words."""

    exit_code = 4


class EvaluationError(SolveError):
    """An evaluation of a hypothesis failed otherwise than by a solve."""


@contextmanager
def evaluating(what: str, record: Callable[[str], object] = lambda _: None) -> Iterator[None]:
    """Whatever is raised inside costs this evaluation alone: it leaves as an `EvaluationError`, but for faults of the machine.

    Args:
        what: is evaluated, in words.
        record: called with the text of an error that is no failed solve.

    Raises:
        EvaluationError: the evaluation failed; a `SolveError` stays as it is.
        MachineError: the machine did.
    """
    try:
        yield
    except (SolveError, MachineError):
        raise
    except MemoryError:
        raise MachineError(SHORT_OF_MEMORY) from None
    except Exception as error:
        reason = str(error) if isinstance(error, BcidError) else f"{type(error).__name__}: {error}"
        record(f"{what}: {reason}")
        raise EvaluationError(f"{what}: {reason}") from error


def bounded(text: str) -> str:
    """A message in which nothing that was quoted is too long to be read: middles of lines, and last lines, are left out."""
    lines = text.split("\n", _MOST_LINES)
    if len(lines) > _MOST_LINES:
        lines[-1] = f"... and {lines[-1].count(chr(10)) + 1} more lines"
    return "\n".join(shortened(line, _WIDEST) for line in lines)


def shortened(text: str, most: int) -> str:
    """Text of at most about `most` characters: of a longer one the middle is left out."""
    if len(text) <= most:
        return text
    # The rule and the remedy stand behind the value.
    return f"{text[: most // 2]} ... ({len(text) - most} characters) ... {text[len(text) - most + most // 2 :]}"


def nearest(word: str, allowed: Iterable[str]) -> str:
    """A hint such as ``did you mean 'x'? known: a, b`` for a misspelt name."""
    known = [str(name) for name in islice(allowed, _LOOKED_THROUGH)]
    similar = [name for name in known if len(name) <= _LONGEST_NAME]
    # A name that differs in upper and lower case alone is the nearest of all.
    by_case = {name.casefold(): name for name in reversed(similar)}
    wanted = str(word).casefold() if len(str(word)) <= _LONGEST_NAME else ""
    close = difflib.get_close_matches(wanted, by_case, n=1) if wanted else []
    hint = f"did you mean '{by_case[close[0]]}'? " if close else ""
    shown = ", ".join(shortened(name, _LONGEST_NAME) for name in known[:24]) + (", ..." if len(known) > 24 else "")
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

    @property
    def counted(self) -> bool:
        """Whether what is found from here on is counted, and not listed: its text need not be made with care."""
        return len(self.found) >= self.shown

    def add_unknown(
        self,
        file: str | Path,
        names: Iterable[str],
        allowed: Iterable[str],
        text: Callable[[str, str], str] = "{}: unknown key; {}".format,
        line: int | None = None,
    ) -> None:
        """Note every name that is not `allowed`; `text` makes a sentence of it and of the hint what was meant."""
        known = set(allowed := list(allowed))
        for name in names:
            if name not in known:
                self.add(file, "" if self.counted else text(name, nearest(name, allowed)), line)

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
