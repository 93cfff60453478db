"""Hypotheses about what holds a body and what acts in it, and sums of their probabilities."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from scipy.special import softmax

from bcid.inference.outcome import label

Anchored = frozenset[str]


@dataclass(frozen=True)
class Hypothesis:
    """What holds the body, and the name of the effect that acts besides; "" for none."""

    anchors: Anchored
    effect: str = ""

    @property
    def order(self) -> tuple[bool, int, list[str], str]:
        """The simpler of two that are as likely comes first."""
        return bool(self.effect), len(self.anchors), sorted(self.anchors), self.effect

    def label(self, names: Iterable[str]) -> str:
        """As in tables: "{3 4} + gravity"; patches in the order of `names`."""
        return label(self.anchors, names) + (f" + {self.effect}" if self.effect else "")


def normalised(logs: Mapping[Hypothesis, float]) -> dict[Hypothesis, float]:
    """Probabilities that sum to one, from logarithms of odds; the likeliest first."""
    if not logs:
        return {}
    shares = softmax(list(logs.values())).tolist()
    return dict(sorted(zip(logs, shares, strict=True), key=lambda item: (-item[1], item[0].order)))


def entropy(probabilities: Iterable[float]) -> float:
    """Entropy in bits."""
    return -math.fsum(p * math.log2(p) for p in probabilities if p > 0)


def patches(probabilities: Mapping[Hypothesis, float], names: Iterable[str]) -> dict[str, float]:
    """Probability that each patch is anchored."""
    return {name: min(1.0, math.fsum(p for h, p in probabilities.items() if name in h.anchors)) for name in names}


def effects(probabilities: Mapping[Hypothesis, float], names: Iterable[str]) -> dict[str, float]:
    """Probability of each effect; of none under the name ""."""
    return {name: min(1.0, math.fsum(p for h, p in probabilities.items() if h.effect == name)) for name in ("", *names)}
