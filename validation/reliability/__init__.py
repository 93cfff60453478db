"""What bcid survives: one file per kind of trouble; ``./dev python -m validation.reliability L1 B2 ...`` runs them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SLAB = ROOT / "examples/scenes/slab.toml"
MEASURED = ROOT / "examples/measurements/slab-34-complex"


@dataclass(frozen=True)
class Reached:
    """What a check has found.

    Attributes:
        goal: in words.
        reached: in words, with numbers.
        met: whether the goal is.
        misses: what went wrong, one line each.
    """

    goal: str
    reached: str
    met: bool
    misses: tuple[str, ...] = ()
