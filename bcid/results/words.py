"""Verdicts in words, as summaries and reports say them."""

from __future__ import annotations

from collections.abc import Sequence

from bcid.base.units import p_value
from bcid.results.common_rows import InputUncertaintyRow
from bcid.results.diagnosis_record import SeparatingPull

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


def pull_text(pull: SeparatingPull) -> str:
    """As in "pull grasp I along +x by 8 mm"; its distance is in m."""
    return f"grasp {pull.grasp} along {pull.direction} by {pull.distance * 1e3:.3g} mm"


def exceeding(rows: Sequence[InputUncertaintyRow]) -> list[str]:
    """By how much more the scene is wrong than it says; in one short sentence where that are more than two inputs."""
    larger = [one for one in rows if one.exceeds_prior]
    if len(larger) <= 2:
        return [one.exceeds_prior for one in larger]
    short = ", ".join(one.exceeds_prior_short for one in larger)
    return [f"more would have to be wrong than the scene allows for (in brackets): {short}"]
