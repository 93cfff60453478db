"""A table of a study, as text and as Markdown."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

# Characters of a line.
_WIDTH = 110


@dataclass(frozen=True)
class TextTable:
    """A table: its title, the heads of its columns, and its rows of text."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self) -> str:
        """Columns under each other, all but the first to the right."""
        return "\n".join([*([wrapped(self.title)] if self.title else []), *aligned([self.head, *self.rows])])

    def markdown(self) -> str:
        """As a table of Markdown."""
        columns = list(zip(*self.rows, strict=True)) if self.rows else [() for _ in self.head]
        lines = [self.head, tuple("---:" if _numbers(column) else "---" for column in columns), *self.rows]
        drawn = ["| " + " | ".join(word.replace("|", "\\|") for word in line) + " |" for line in lines]
        return "\n".join([*([f"{self.title}", ""] if self.title else []), *drawn])


def _numbers(column: Sequence[str]) -> bool:
    """Whether a column holds numbers alone: digits, points, and what stands between two of them."""
    return any(column) and all(re.fullmatch(r"[-+0-9.,/% ()]*|[0-9.]+ \([0-9.]+ to [0-9.]+\)", word) for word in column)


def wrapped(text: str) -> str:
    """A text in lines that a terminal shows whole."""
    return textwrap.fill(" ".join(text.split()), _WIDTH)


def aligned(lines: Sequence[Sequence[str]]) -> list[str]:
    """Columns of text under each other, all but the first to the right."""
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return [
        "  ".join(
            f"{word:<{w}}" if i == 0 else f"{word:>{w}}" for i, (word, w) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    ]
