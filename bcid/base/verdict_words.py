"""Verdicts in words, as summaries and reports say them."""

from __future__ import annotations

from collections.abc import Sequence

from bcid.base.units import p_value

# Verdicts that are no effects.
NO_EFFECTS = {
    "none": "nothing missing",
    "unknown": "something unknown",
    # In runs of version 0.8 and before.
    "others": "effects that were not looked at",
}


def not_adequate_either(p: float) -> str:
    """That a model with the effects that are named does not explain all of a measurement, as its p-value says."""
    return f"With that the model is not adequate either ({p_value(p)}): something else may act besides, or instead."


def used_up(larger: Sequence[tuple[str, str]]) -> list[str]:
    """By how much more the scene is wrong than it says, from what is told of each way at length and briefly.

    Where there are more than two, they are told briefly, in one sentence.
    """
    if len(larger) <= 2:
        return [at_length for at_length, _ in larger]
    briefly = ", ".join(brief for _, brief in larger)
    return [f"more would have to be wrong than the scene allows for (in brackets): {briefly}"]
