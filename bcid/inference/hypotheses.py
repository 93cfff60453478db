"""Hypotheses about what holds a body and what acts in it, and sums of their probabilities."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

from scipy.special import softmax

from bcid.inference.priors import PRIORS

Anchored = frozenset[str]


def label(anchors: Iterable[str], order: Iterable[str]) -> str:
    """A set in words, patches in the scene's order: "{1 2}"."""
    chosen = set(anchors)
    return "{" + " ".join(name for name in order if name in chosen) + "}"


@dataclass(frozen=True)
class Hypothesis:
    """What holds the body, what acts besides ("gravity", "gravity+fibres"; "": nothing), and whether something unknown does too."""

    anchors: Anchored
    effect: str = ""
    unknown: bool = False

    @property
    def order(self) -> tuple[bool, bool, int, list[str], str]:
        """The simpler of two that are as likely comes first."""
        return bool(self.effect), self.unknown, len(self.anchors), sorted(self.anchors), self.effect

    @property
    def known(self) -> Hypothesis:
        """The same without a discrepancy."""
        return replace(self, unknown=False) if self.unknown else self

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects that act."""
        return tuple(self.effect.split("+")) if self.effect else ()

    @property
    def verdict(self) -> str:
        """The effect, "none", or "unknown" where a discrepancy acts besides."""
        return "unknown" if self.unknown else self.effect or "none"

    def label(self, names: Iterable[str]) -> str:
        """As in tables: "{3 4} + gravity"; patches in the order of `names`."""
        return label(self.anchors, names) + (f" + {self.effect}" if self.effect else "")


def log_prior(effects: int, unknown: bool, known: int) -> float:
    """Logarithm of the prior odds, against nothing, of so many named effects of the `known` ones, and something unknown besides.

    Every effect acts with the same probability, whatever else does.
    """
    each = PRIORS.effects / max(known, 1)
    odds = effects * math.log(each / (1 - min(each, 0.5)))
    return odds + (math.log(PRIORS.discrepancy / (1 - PRIORS.discrepancy)) if unknown else 0.0)


def normalised(logs: Mapping[Hypothesis, float]) -> dict[Hypothesis, float]:
    """Probabilities that sum to one, from logarithms of odds; the likeliest first."""
    if not logs:
        return {}
    shares = softmax(list(logs.values())).tolist()
    return dict(sorted(zip(logs, shares, strict=True), key=lambda item: (-item[1], item[0].order)))


@dataclass(frozen=True)
class HypothesisOdds:
    """What is believed of hypotheses, the likeliest first.

    Attributes:
        probabilities: of each; they sum to one.
        alike: whether effects are ways to write the same, as forms of an energy are: that one of them acts, whatever acts besides,
            is then one verdict, to which a discrepancy alone is the other.
    """

    probabilities: dict[Hypothesis, float]
    alike: bool = False

    @classmethod
    def of(cls, logs: Mapping[Hypothesis, float], alike: bool = False) -> HypothesisOdds:
        """From logarithms of evidence and prior."""
        return cls(normalised(logs), alike)

    @property
    def verdicts(self) -> dict[str, float]:
        """Probability of each effect or pair of effects, of "none" and of "unknown", the likeliest first."""
        return self._shares(lambda h: h.verdict)

    @property
    def best(self) -> Hypothesis:
        """The likeliest hypothesis of the likeliest verdict."""
        likeliest = next(iter(self._shares(self._told)))
        return next(h for h in self.probabilities if self._told(h) == likeliest)

    def _told(self, h: Hypothesis) -> str:
        """What a hypothesis has in common with others that count with it."""
        return "known" if self.alike and h.names else h.verdict

    def _shares(self, told: Callable[[Hypothesis], str]) -> dict[str, float]:
        """Probability of all hypotheses that are told alike, the likeliest first."""
        found = {"none": 0.0, "unknown": 0.0}
        for h, p in self.probabilities.items():
            found[told(h)] = found.get(told(h), 0.0) + p
        return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))

    def acting(self, effect: str) -> float:
        """Probability that these effects act, and perhaps others besides."""
        wanted = set(effect.split("+"))
        return min(1.0, math.fsum(p for h, p in self.probabilities.items() if wanted <= set(h.names)))

    def held_by(self, anchors: Anchored) -> float:
        """Probability of a set."""
        return min(1.0, math.fsum(p for h, p in self.probabilities.items() if h.anchors == anchors))


def entropy(probabilities: Iterable[float]) -> float:
    """Entropy in bits."""
    return -math.fsum(p * math.log2(p) for p in probabilities if p > 0)


def patches(probabilities: Mapping[Hypothesis, float], names: Iterable[str]) -> dict[str, float]:
    """Probability that each patch is anchored."""
    return {name: min(1.0, math.fsum(p for h, p in probabilities.items() if name in h.anchors)) for name in names}


def effects(probabilities: Mapping[Hypothesis, float], names: Iterable[str]) -> dict[str, float]:
    """Probability of each effect; of none under the name ""."""
    return {name: min(1.0, math.fsum(p for h, p in probabilities.items() if h.effect == name)) for name in ("", *names)}
