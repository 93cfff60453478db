"""Tables of a report: as HTML, CSV and LaTeX, numbers aligned by their decimal point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bcid.base.csv_text import csv_text
from bcid.report.markup import Markup, tag

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
    """A column: its head, what it holds (`TEXT` or `NUMBER`), and whether a narrow screen can do without it."""

    head: str
    kind: str = NUMBER
    less: bool = False


@dataclass(frozen=True)
class Table:
    """Rows of cells as they are read; `exact` are the same with full numbers, for CSV.

    Attributes:
        name: of its files.
        caption: what is to be seen.
        columns: of every row.
        rows: cells as text.
        exact: cells as numbers and text.
        strong: numbers of rows that stand out.
    """

    name: str
    caption: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[str]]
    exact: Sequence[Sequence[object]]
    strong: frozenset[int] = frozenset()

    def html(self) -> Markup:
        """The table as an element that scrolls by itself where it is too broad."""
        aligned = self._aligned("\u2007", "\u2008")
        head = tag("tr", [tag("th", column.head, class_=_class(column), scope="col") for column in self.columns])
        body = [
            tag(
                "tr",
                [tag("td", cell, class_=_class(column)) for column, cell in zip(self.columns, row, strict=True)],
                class_="strong" if i in self.strong else None,
            )
            for i, row in enumerate(aligned)
        ]
        last = (
            len(self.columns) > 1
            and self.columns[-1].kind == TEXT
            and max(map(len, (r[-1] for r in self.rows)), default=0)
        )
        shape = "wide-last" if last and last > _LONG else None
        return tag(
            "div", tag("table", tag("thead", head), tag("tbody", body), class_=shape), class_="table", tabindex="0"
        )

    def csv(self) -> str:
        """The table with full numbers; a cell that a spreadsheet would take for a formula begins with an apostrophe."""
        return csv_text([[column.head for column in self.columns], *self.exact])

    def latex(self) -> str:
        """A tabular environment (package booktabs)."""
        shape = "".join("l" if column.kind == TEXT else "r" for column in self.columns)
        lines = [rf"% {_latex(self.caption)}", rf"\begin{{tabular}}{{{shape}}}", r"\toprule"]
        lines += [" & ".join(_latex(column.head) for column in self.columns) + r" \\", r"\midrule"]
        for row in self._aligned("\u2007", "\u2008"):
            lines.append(" & ".join(map(_latex, row)) + r" \\")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])

    def _aligned(self, digit: str, point: str) -> list[list[str]]:
        """Cells with spaces as wide as the decimals that others have and they have not."""
        columns = []
        for k, column in enumerate(self.columns):
            cells = [row[k] for row in self.rows]
            columns.append(aligned(cells, digit, point) if column.kind == NUMBER else cells)
        return [list(row) for row in zip(*columns, strict=True)] if self.rows else []


def aligned(cells: Sequence[str], digit: str = "\u2007", point: str = "\u2008") -> list[str]:
    """Plain decimal numbers padded on the right, so that their points stand below each other; others as they are."""
    decimals = [_decimals(cell) for cell in cells]
    most = max((count for count in decimals if count is not None), default=0)
    padded = []
    for cell, count in zip(cells, decimals, strict=True):
        missing = 0 if count is None else most - count
        gap = point if count == 0 and most > 0 else ""
        padded.append(cell + gap + digit * missing)
    return padded


def _decimals(cell: str) -> int | None:
    """How many decimals a number has; None where it is no plain number."""
    whole, _, decimals = cell.removeprefix("−").removeprefix("-").partition(".")
    if not whole.isdecimal() or (decimals and not decimals.isdecimal()):
        return None
    return len(decimals)


def _class(column: Column) -> str:
    return " ".join([column.kind, *(["less"] if column.less else [])])


def _latex(cell: str) -> str:
    spaces = {"\u2007": r"\phantom{0}", "\u2008": r"\phantom{.}", "\n": " ", "\r": " "}
    return "".join(spaces.get(c) or _LATEX.get(c, c) for c in cell)
