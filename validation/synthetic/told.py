"""Are the told probabilities right as often as they say?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.synthetic.judge import SURE, anchors_right, set_right, verdict_right
from validation.synthetic.wilson import rate

BINS = (0.0, 0.5, 0.7, 0.9, 0.95, 0.99, 1.0)
# A probability that an answer is right, and whether it is.
Told = tuple[float, bool]


def told(result: Mapping[str, Any]) -> list[Told]:
    """Of the verdict and of the anchored patches of a case, as far as its diagnosis tells them."""
    truth, diagnosis = result["truth"], result["diagnosis"]
    if truth is None or diagnosis is None:
        return []
    found = []
    if diagnosis.get("verdict_probability") is not None:
        found.append((float(diagnosis["verdict_probability"]), verdict_right(truth, diagnosis)))
    probability = _of_asked(truth, diagnosis)
    if probability is not None:
        found.append((probability, anchors_right(truth, diagnosis)))
    return found


def _of_asked(truth: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> float | None:
    """Told probability of the anchored patches that are asked for, the others being as they are; None where no such set is told.

    A patch that is not asked for is never anchored in a study, for of an anchored one it must show. The diagnosis cannot know that,
    and rightly spreads what it believes over sets with and without it. One that lists no sets tells only that of its own.
    """
    apart, sets = set(truth["not_asked"]), dict[frozenset[str], float]()
    listed = diagnosis.get("posterior", {}).get("hypotheses", ())
    if not listed:
        return diagnosis.get("anchors_probability")
    for hypothesis in listed:
        anchored = frozenset(hypothesis["anchored"])
        sets[anchored] = sets.get(anchored, 0.0) + float(hypothesis["probability"])
    alike = {s: p for s, p in sets.items() if s & apart == set(truth["anchored"]) & apart}
    told = set(diagnosis["anchored"]) - apart
    whole = sum(alike.values())
    return sum(p for s, p in alike.items() if s - apart == told) / whole if whole else None


def sure_and_wrong(result: Mapping[str, Any]) -> list[bool]:
    """Of the verdict and of the set of a case, as far as they are told with 95 % or more: whether they are wrong.

    Of the set to the last patch, for it is told so.
    """
    truth, diagnosis = result["truth"], result["diagnosis"]
    if truth is None or diagnosis is None:
        return []
    answers = (("verdict_probability", verdict_right), ("anchors_probability", set_right))
    return [not right(truth, diagnosis) for told, right in answers if (diagnosis.get(told) or 0.0) >= SURE]


def calibration(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Told and found by bins of what was told, their expected difference, and how many of the sure answers are wrong.

    `by_chance` is that difference where each answer is right exactly as often as it is told: there are only so many of them.
    """
    every = [pair for result in results for pair in told(result)]
    place = np.clip(np.digitize([p for p, _ in every], BINS) - 1, 0, len(BINS) - 2)
    binned = [[pair for at, pair in zip(place, every, strict=True) if at == k] for k in range(len(BINS) - 1)]
    bins = [_bin(k, pairs) for k, pairs in enumerate(binned)]
    error = sum(b["count"] * abs(b["told"] - b["rate"]) for b in bins if b["count"])
    chance = sum(_by_chance([p for p, _ in pairs]) for pairs in binned)
    return {
        "count": len(every),
        "expected_error": error / len(every) if every else None,
        "by_chance": chance / len(every) if every else None,
        "sure_and_wrong": rate([wrong for result in results for wrong in sure_and_wrong(result)]),
        "bins": bins,
    }


def _by_chance(told: Sequence[float]) -> float:
    """By how much the number of right answers differs from what is expected of them, on average."""
    counts: NDArray[np.float64] = np.ones(1)
    for p in told:
        counts = np.asarray(np.convolve(counts, [1 - p, p]), dtype=float)
    return float(counts @ np.abs(np.arange(len(counts)) - sum(told)))


def _bin(k: int, pairs: Sequence[Told]) -> dict[str, Any]:
    told_on_average = float(np.mean([p for p, _ in pairs])) if pairs else None
    return {"from": BINS[k], "to": BINS[k + 1], "told": told_on_average} | rate([right for _, right in pairs])
