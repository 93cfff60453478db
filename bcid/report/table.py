"""Tables of a report: as HTML, CSV and LaTeX, numbers aligned by their decimal point."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from bcid.base.csv_text import csv_text

TEXT, NUMBER = "text", "number"
# A last column of longer cells gets more room.
_LONG = 30
_LATEX = {
    "\\": r"\textbackslash{}",
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "−": "$-$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "→": r"$\to$",
    "µ": r"$\mu$",
    "…": r"\dots{}",
    **{c: f"$^{{{d}}}$" for c, d in zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789", strict=True)},
}


# A record, or a table of values.
_Row = Any


class Cell(NamedTuple):
    """What is shown of a value, and the exact value."""

    shown: str
    exact: Any


def rounded(value: float | None) -> str:
    """A number to three digits; "" where there is none."""
    return "" if value is None or not math.isfinite(value) else f"{value:#.3g}".rstrip(".")


@dataclass(frozen=True)
class Column:
    """A column, of numbers unless `kind` says otherwise.

    Attributes:
        head: above it.
        value: its cell of a row: a key or an attribute (the head, if it is ""), or a function of the row; a `Cell`
            is taken as it is.
        show: how a value is shown.
        less: whether a narrow screen can do without it.
        kind: what it holds, `TEXT` or `NUMBER`.
    """

    head: str
    value: str | Callable[[_Row], Any] = ""
    show: Callable[[Any], str] = rounded
    less: bool = False
    kind: str = NUMBER

    def cell(self, row: _Row) -> Cell:
        """What is shown of a row, and the exact value."""
        found = _found(row, self.value or self.head) if isinstance(self.value, str) else self.value(row)
        return found if isinstance(found, Cell) else Cell(self.show(found), found)


def _found(row: _Row, name: str) -> Any:
    return row[name] if isinstance(row, Mapping) else getattr(row, name)


def text(
    head: str, value: str | Callable[[_Row], Any] = "", show: Callable[[Any], str] = str, less: bool = False
) -> Column:
    """A column of text."""
    return Column(head, value, show, less, TEXT)


class Table:
    """Rows of cells, as they are read and with full numbers.

    Attributes:
        caption: what is to be seen.
        columns: of every row.
        rows: cells as text.
        exact: cells as numbers and text, for CSV.
        strong: numbers of rows that stand out.

    Args:
        rows: what columns find their cells in.
        strong: whether a row stands out.
    """

    def __init__(
        self,
        caption: str,
        columns: Sequence[Column],
        rows: Sequence[_Row],
        strong: Callable[[_Row], bool] = lambda row: False,
    ) -> None:
        self.caption, self.columns = caption, columns
        cells = [[column.cell(row) for column in columns] for row in rows]
        self.rows = [[shown for shown, _ in row] for row in cells]
        self.exact = [[_exact(value) for _, value in row] for row in cells]
        self.strong = {i for i, row in enumerate(rows) if strong(row)}

    @property
    def wide_last(self) -> bool:
        """Whether the last column needs more room."""
        return (
            len(self.columns) > 1 and self.columns[-1].kind == TEXT and any(len(row[-1]) > _LONG for row in self.rows)
        )

    def csv(self) -> str:
        """The table with full numbers; a cell that a spreadsheet would take for a formula begins with an apostrophe."""
        return csv_text([[column.head for column in self.columns], *self.exact])

    def latex(self) -> str:
        """A tabular environment (package booktabs)."""
        shape = "".join("l" if column.kind == TEXT else "r" for column in self.columns)
        lines = [rf"% {_latex(self.caption)}", rf"\begin{{tabular}}{{{shape}}}", r"\toprule"]
        lines += [" & ".join(_latex(column.head) for column in self.columns) + r" \\", r"\midrule"]
        for row in self.aligned:
            lines.append(" & ".join(map(_latex, row)) + r" \\")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])

    @property
    def aligned(self) -> list[tuple[str, ...]]:
        """Cells with spaces as wide as the decimals that others have and they have not."""
        columns = zip(self.columns, zip(*self.rows, strict=True), strict=False)
        return list(
            zip(*(aligned(cells) if column.kind == NUMBER else cells for column, cells in columns), strict=True)
        )


def _exact(value: Any) -> Any:
    """A value as a cell of a file."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return " ".join(map(str, value)) or "none" if isinstance(value, list | tuple) else value


def aligned(cells: Sequence[str]) -> list[str]:
    """Plain decimal numbers padded on the right, so that their points stand below each other; others as they are."""
    decimals = [_decimals(cell) for cell in cells]
    most = max((count for count in decimals if count is not None), default=0)
    padded = []
    for cell, count in zip(cells, decimals, strict=True):
        missing = 0 if count is None else most - count
        gap = "\u2008" if count == 0 and most > 0 else ""
        padded.append(cell + gap + "\u2007" * missing)
    return padded


def _decimals(cell: str) -> int | None:
    """How many decimals a number has; None where it is no plain number."""
    whole, _, decimals = cell.removeprefix("−").removeprefix("-").partition(".")
    if not whole.isdecimal() or (decimals and not decimals.isdecimal()):
        return None
    return len(decimals)


def _latex(cell: str) -> str:
    spaces = {"\u2007": r"\phantom{0}", "\u2008": r"\phantom{.}", "\n": " ", "\r": " "}
    return "".join(spaces.get(c) or _LATEX.get(c, c) for c in cell)
