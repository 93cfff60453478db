"""A rate and its interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scipy.stats import binomtest


def wilson(met: int, count: int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    if count == 0:
        return 0.0, 1.0
    interval = binomtest(met, count).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def rate(met: Sequence[bool]) -> dict[str, Any]:
    """How many of some answers are right, of how many, the rate and its interval."""
    low, high = wilson(sum(met), len(met))
    return {"met": sum(met), "count": len(met), "rate": sum(met) / len(met) if met else None, "low": low, "high": high}
