"""Verdicts in words, as summaries and reports say them."""

from __future__ import annotations

from collections.abc import Sequence

from bcid.base.units import p_value

# Verdicts that are no effects.
NO_EFFECTS = {
    "none": "nothing missing",
    "unknown": "something unknown",
    "others": "effects that were not looked at",
}


def not_adequate_either(p: float) -> str:
    """That a model with the effects that are named does not explain all of a measurement, as its p-value says."""
    return f"With that the model is not adequate either ({p_value(p)}): something else may act besides, or instead."


def all_used_up(larger: Sequence[str]) -> str:
    """That the scene is wrong by more than it says in many ways, each told with the standard deviation that it allows for."""
    return f"more would have to be wrong than the scene allows for (in brackets): {', '.join(larger)}"
