"""Verdicts in words, as summaries and reports say them."""

from __future__ import annotations

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
