"""Tables of a report: as HTML, CSV and LaTeX, numbers aligned by their decimal point."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import InitVar, dataclass, field
from typing import Any

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


@dataclass(frozen=True)
class Column:
    """A column: its head, what it holds (`TEXT` or `NUMBER`), how a cell is shown, and whether narrow screens leave it out."""

    head: str
    kind: str
    show: Callable[[Any], str]
    less: bool = False


def text(head: str, show: Callable[[Any], str] = str, less: bool = False) -> Column:
    """A column of text."""
    return Column(head, TEXT, show, less)


def rounded(value: float | None) -> str:
    """A number to three digits; "" where there is none."""
    return "" if value is None or not math.isfinite(value) else f"{value:#.3g}".rstrip(".")


def number(head: str, show: Callable[[Any], str] = rounded, less: bool = False) -> Column:
    """A column of numbers."""
    return Column(head, NUMBER, show, less)


@dataclass
class Table:
    """Rows of cells, as they are read and with full numbers.

    Attributes:
        caption: what is to be seen.
        columns: of every row.
        cells: values that columns show, or pairs of what is shown and the exact value.
        strong: numbers of rows that stand out.
        rows: cells as text.
        exact: cells as numbers and text, for CSV.
    """

    caption: str
    columns: Sequence[Column]
    cells: InitVar[Sequence[Sequence[Any]]]
    strong: Collection[int] = ()
    rows: list[list[str]] = field(init=False)
    exact: list[list[Any]] = field(init=False)

    def __post_init__(self, cells: Sequence[Sequence[Any]]) -> None:
        self.rows, self.exact = [], []
        for row in cells:
            pairs = [
                cell if isinstance(cell, tuple) else (column.show(cell), _exact(cell))
                for column, cell in zip(self.columns, row, strict=True)
            ]
            self.rows.append([shown for shown, _ in pairs])
            self.exact.append([value for _, value in pairs])

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
    return " ".join(map(str, value)) or "none" if isinstance(value, list) else value


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
