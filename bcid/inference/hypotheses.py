"""What is believed of the anchors after some pulls: Bayes' rule over anchor sets, with noise and the error of the model.

A measured coordinate follows its prediction up to white noise and an error of the model that persists along the
trajectory and grows with the motion: y = mu + b s + e, with b ~ N(0, error^2), s the part of the motion that is done (0 at
rest, 1 at its end) and e ~ N(0, sigma^2 + (error / 2)^2). Logarithms are kept, so that a set is never lost by underflow.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from bcid.inference.outcome import label

Array = NDArray[np.float64]
Anchored = frozenset[str]
# Part of the error of the model that differs from frame to frame.
_ROUGH = 0.5
# Without noise and error: what a solver leaves, m.
LEAST = 1e-6


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


@dataclass(frozen=True)
class Spread:
    """Covariance of one pull's measured coordinates about a prediction, the same for every trajectory.

    Attributes:
        profile: part of the motion that is done in each frame, shape (frames,).
        sigma: standard deviation of the noise, m.
        error: standard deviation of the model's error at the end of the motion, m.
    """

    profile: Array
    sigma: float
    error: float

    @property
    def white(self) -> float:
        """Standard deviation of what differs from frame to frame, m."""
        return math.hypot(self.sigma, _ROUGH * self.error, LEAST)

    def whiten(self, difference: Array) -> Array:
        """A difference (frames, ...), m, in units in which its errors are independent and of size one; NaN counts as zero."""
        scaled = np.nan_to_num(difference) / self.white
        size = self.error * float(np.linalg.norm(self.profile)) / self.white
        if size == 0.0:
            return np.asarray(scaled)
        along = self.profile / np.linalg.norm(self.profile)
        shrink = 1 - 1 / math.sqrt(1 + size**2)
        return np.asarray(scaled - shrink * np.tensordot(along, np.tensordot(along, scaled, axes=(0, 0)), axes=0))

    def log_volume(self, seen: NDArray[np.bool_]) -> float:
        """Half the logarithm of the determinant of the covariance of what was seen, (frames, fiducials, 3), of it in m."""
        size = self.error * float(np.linalg.norm(self.profile)) / self.white
        return int(seen.sum()) * math.log(self.white) + int(seen.any(axis=0).sum()) * 0.5 * math.log1p(size**2)


class Belief:
    """Odds of anchor sets from the logarithms of their likelihoods, pull by pull.

    A hypothesis that was not looked at after some of the pulls keeps what it had: it is compared with the best one over the
    pulls that both know, which is its chance to come back.
    """

    def __init__(self) -> None:
        self.logs: dict[Anchored, dict[int, float]] = {}

    def add(self, pull: int, logs: Mapping[Anchored, float]) -> None:
        """Take the logarithms of the likelihoods of one pull; `-inf` for a set that cannot be predicted."""
        for anchors, value in logs.items():
            self.logs.setdefault(anchors, {})[pull] = value

    def known(self, anchors: Anchored) -> set[int]:
        """The pulls that a set was compared with."""
        return set(self.logs.get(anchors, {}))

    def relative(self) -> dict[Anchored, float]:
        """Logarithm of every set's odds against the best of those that know all pulls."""
        every = set().union(*(known for known in self.logs.values())) if self.logs else set()
        full = {a: known for a, known in self.logs.items() if set(known) == every}
        if not full:
            return dict.fromkeys(self.logs, 0.0)
        best = max(full, key=lambda a: (sum(full[a].values()), -len(a), sorted(a)))
        reference = full[best]
        if not math.isfinite(sum(reference.values())):
            return dict.fromkeys(self.logs, 0.0)
        return {a: sum(value - reference[pull] for pull, value in known.items()) for a, known in self.logs.items()}


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
