"""What a part of the benchmark found: tables, and goals that are reached or not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Goal:
    """A number that was to be reached.

    Attributes:
        what: in words.
        wanted: the number; at least this, or at most with `at_most`.
        reached: what was measured; None when it could not be.
        unit: written behind both numbers.
    """

    what: str
    wanted: float
    reached: float | None
    at_most: bool = False
    unit: str = ""

    @property
    def met(self) -> bool | None:
        """Whether it was reached; None when it was not measured."""
        if self.reached is None:
            return None
        return self.reached <= self.wanted if self.at_most else self.reached >= self.wanted

    def row(self) -> list[str]:
        """The goal as a row of a table."""
        sign = "≤" if self.at_most else "≥"
        reached = "not measured" if self.reached is None else f"{number(self.reached)}{self.unit}"
        return [self.what, f"{sign} {number(self.wanted)}{self.unit}", reached, verdict(self.met)]


def verdict(met: bool | None) -> str:
    """In a word that is easy to see."""
    return "-" if met is None else "yes" if met else "NO"


def number(value: float) -> str:
    """Three digits, without an exponent where that is readable."""
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return f"{value:.1e}"


@dataclass(frozen=True)
class BenchTable:
    """Rows of text under a title."""

    title: str
    columns: tuple[str, ...]
    rows: list[list[str]]

    def text(self) -> str:
        """Aligned: the first column to the left, the others to the right."""
        lines = [list(self.columns), *self.rows]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.columns))]
        aligned = [
            "  ".join(
                cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(line, widths, strict=True))
            )
            for line in lines
        ]
        rule = "-" * len(aligned[0])
        return "\n".join([self.title, rule, aligned[0].rstrip(), rule, *(line.rstrip() for line in aligned[1:]), rule])


@dataclass
class Part:
    """Everything one part found.

    Attributes:
        name, title: as on the command line, and in words.
        tables: what was measured.
        goals: what was to be reached.
        notes: what must be known to read them.
        data: the numbers behind, for bench.json.
        plots: files written.
    """

    name: str
    title: str
    tables: list[BenchTable] = field(default_factory=list)
    goals: list[Goal] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)
    plots: list[str] = field(default_factory=list)

    def text(self) -> str:
        """For the terminal."""
        blocks = [f"=== {self.name}: {self.title}", *(table.text() for table in self.tables)]
        if self.goals:
            blocks.append(goals_table(self.goals).text())
        blocks += [f"note: {note}" for note in self.notes]
        return "\n\n".join(blocks)

    def to_json(self) -> dict[str, Any]:
        """For bench.json."""
        return {
            "title": self.title,
            "tables": [asdict(table) for table in self.tables],
            "goals": [asdict(goal) | {"met": goal.met} for goal in self.goals],
            "notes": self.notes,
            "data": self.data,
            "plots": self.plots,
        }


def goals_table(goals: Sequence[Goal]) -> BenchTable:
    """Goal, reached, met."""
    return BenchTable("goals", ("goal", "wanted", "reached", "met"), [goal.row() for goal in goals])
