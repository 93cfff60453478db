"""The posterior: probabilities of hypotheses whose evidences are known at different fidelities.

An evidence is exact where a hypothesis was fitted to all steps. A lower fidelity knows it against a hypothesis k that was, and errs
by a factor in their difference. The logarithm of the factor is a sum over the T patches and effects in which the two differ, with
one error for each, shared by all hypotheses with that toggle:

    P(h | d) = E_u [Z_h(u) p(h) / sum_j Z_j(u) p(j)],
    log Z_h(u) = min(C, l_k + (l_h - l_k) exp(b + s sum_t u_t / sqrt(T))),                                                (2)

where C is the evidence of a hypothesis that explains all. With errors of their own some of thousands of unlikely hypotheses would
always be drawn as likely. Bias and scale are learned from the pairs of fidelities that a run has, apart for patches and effects and
for gains and losses: with a normal-inverse-gamma prior b and s u_t have a multivariate Student distribution with four degrees of
freedom, and one more for each pair (Gelman et al., Bayesian Data Analysis, 3rd ed. 2013, section 14.8).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from bcid.inference.hypotheses import Hypothesis
from bcid.inference.priors import PRIORS

Array = NDArray[np.float64]
# Exponentials that are computed together, so that memory is bounded.
_AT_A_TIME = 2_000_000
# A logarithm of a factor that makes any hypothesis impossible.
_LARGEST = 50.0


class Fidelity(IntEnum):
    """How an evidence is known: from a linearisation, in a few steps, in all steps."""

    TANGENT = 0
    COARSE = 1
    FULL = 2


class Kind(NamedTuple):
    """What has errors of the same size: toggled patches or effects, at a fidelity, that gain or lose by a tangent."""

    fidelity: Fidelity
    effect: bool
    gains: bool


class Toggle(NamedTuple):
    """A patch or an effect in which two hypotheses differ, at a fidelity below the full one."""

    kind: Kind
    name: str

    @property
    def bias(self) -> Toggle:
        """What stands for the error that all of its kind have in common."""
        return self._replace(name="")


Toggles = tuple[Toggle, ...]


def toggles(fidelity: Fidelity, one: Hypothesis, other: Hypothesis, gain: float) -> Toggles:
    """In which a hypothesis differs from another, whose evidence it exceeds by so much in the logarithm; sorted."""
    # A few steps treat both alike, and which is known against which is a matter of convention.
    gains = fidelity == Fidelity.TANGENT and gain > 0
    patches, effects = (Kind(fidelity, effect, gains) for effect in (False, True))
    found = [Toggle(patches, name) for name in one.anchors ^ other.anchors]
    found += [Toggle(effects, name) for name in set(one.names) ^ set(other.names)]
    return tuple(sorted(found))


@dataclass(frozen=True)
class Evaluation:
    """What is known of a hypothesis.

    Attributes:
        base: logarithm of the evidence of the one that it is known against; its own at the full fidelity.
        gain: by how much its own exceeds that.
        log_prior: logarithm of its prior odds.
        toggles: in which it differs from that one; none at the full fidelity.
    """

    base: float
    gain: float
    log_prior: float
    toggles: Toggles = ()


@dataclass(frozen=True)
class Pair:
    """A hypothesis that is known at two fidelities.

    Attributes:
        toggles: in which it differs from the one that the lower fidelity knows it against.
        low, high: by how much the logarithm of its evidence exceeds that one's, at either.
    """

    toggles: Toggles
    low: float
    high: float

    @property
    def kind(self) -> Kind:
        """Whose error it tells."""
        return min((toggle.kind for toggle in self.toggles), key=lambda kind: (kind.fidelity, not kind.effect))

    @property
    def miss(self) -> float:
        """Logarithm of the factor by which the difference was wrong; where it has the other sign, nothing was left of it."""
        low, high = (float(_apart(np.array(gain))) for gain in (self.low, self.high))
        return math.log(high / low) if high * low > 0 else -math.log(abs(low))


class Posterior:
    """Equation (2).

    Args:
        evaluations: of each hypothesis.
        pairs: from which the errors of the fidelities are learned.
        ceiling: logarithm of the evidence of a hypothesis that explains all.
    """

    def __init__(
        self, evaluations: Mapping[Hypothesis, Evaluation], pairs: Iterable[Pair] = (), ceiling: float = math.inf
    ) -> None:
        self.evaluations = dict(evaluations)
        self.pairs = [pair for pair in pairs if pair.toggles and math.isfinite(pair.low + pair.high)]
        self.ceiling = ceiling
        self._learned: dict[tuple[Kind, Toggles], tuple[Array, Array, float]] = {}

    def probabilities(self) -> dict[Hypothesis, float]:
        """Of each hypothesis, the most probable first; they sum to one."""
        if not self.evaluations:
            return {}
        known = list(self.evaluations.values())
        every = _with_biases(toggle for one in known for toggle in one.toggles)
        base, gain, prior = (np.array([getattr(one, name) for one in known]) for name in ("base", "gain", "log_prior"))
        weights, exact = _weights([one.toggles for one in known], every), np.array([not one.toggles for one in known])
        errors, shares = self.errors(every), np.zeros(len(known))
        for part in np.array_split(errors, math.ceil(len(errors) * len(known) / _AT_A_TIME)):
            drawn = base + _apart(gain) * np.exp(np.minimum(part @ weights.T, _LARGEST))
            logs = np.where(exact, base + gain, np.minimum(drawn, self.ceiling))
            shares += np.sum(softmax(logs + prior, axis=1), axis=0)
        found = {h: float(share) / len(errors) for h, share in zip(self.evaluations, shares, strict=True)}
        return dict(sorted(found.items(), key=lambda item: (-item[1], item[0].order)))

    def errors(self, every: Sequence[Toggle]) -> Array:
        """Fixed draws of the errors of toggles, shape (draws, toggles)."""
        found = np.zeros((PRIORS.draws, len(every)))
        for kind in sorted({toggle.kind for toggle in every}):
            own = [k for k, toggle in enumerate(every) if toggle.kind == kind]
            found[:, own] = self._drawn(kind, tuple(every[k] for k in own))
        return found

    def _drawn(self, kind: Kind, wanted: Toggles) -> Array:
        """Draws of the errors of toggles of a kind given the pairs, shape (draws, wanted)."""
        mean, root, freedom = self.learned(kind, wanted)
        generator = np.random.default_rng([int(part) for part in kind])
        normal = generator.standard_normal((PRIORS.draws, len(wanted)))
        mixing = np.sqrt(freedom / generator.chisquare(freedom, (PRIORS.draws, 1)))
        return np.asarray(mean + mixing * (normal @ root.T))

    def learned(self, kind: Kind, wanted: Toggles) -> tuple[Array, Array, float]:
        """Of the errors of toggles of a kind, given its pairs.

        Returns:
            Their mean, shape (k,), a root of their scale matrix, (k, k), and their degrees of freedom. Of a pair with toggles of
            several kinds the error is taken to be that of the lowest fidelity, and of effects before patches.
        """
        key = kind, wanted
        if key not in self._learned:
            self._learned[key] = self._learn(kind, wanted)
        return self._learned[key]

    def _learn(self, kind: Kind, wanted: Toggles) -> tuple[Array, Array, float]:
        pairs = [pair for pair in self.pairs if pair.kind == kind]
        own = [tuple(toggle for toggle in pair.toggles if toggle.kind == kind) for pair in pairs]
        every = _with_biases([*wanted, *(toggle for some in own for toggle in some)])
        scale = PRIORS.fidelity_error[kind.fidelity]
        covariance = scale**2 * np.eye(len(every))
        mean, freedom = np.zeros(len(every)), PRIORS.error_freedom
        if pairs:
            design, misses = _weights(own, every), np.array([pair.miss for pair in pairs])
            # What toggles do together is as uncertain as what each does.
            expected = design @ covariance @ design.T + scale**2 * np.eye(len(pairs))
            gain = np.linalg.solve(expected, design @ covariance).T
            surprise = float(misses @ np.linalg.solve(expected, misses))
            mean, covariance = gain @ misses, covariance - gain @ design @ covariance
            covariance *= (freedom + surprise) / (freedom + len(pairs))
            freedom += len(pairs)
        at = [every.index(t) for t in wanted]
        values, vectors = np.linalg.eigh(covariance[np.ix_(at, at)])
        return mean[at], vectors * np.sqrt(np.maximum(values, 0.0)), freedom

    def variance(self, one: Evaluation) -> float:
        """Of the error of an evidence, as a square of scales: by it two ways to know the same are compared."""
        total, every = 0.0, _with_biases(one.toggles)
        weights = _weights([one.toggles], every)[0]
        for kind in sorted({toggle.kind for toggle in every}):
            own = [k for k, toggle in enumerate(every) if toggle.kind == kind]
            total += float(np.sum((self.learned(kind, tuple(every[k] for k in own))[1].T @ weights[own]) ** 2))
        return total * float(_apart(np.array(one.gain))) ** 2


def _apart(gains: Array) -> Array:
    """Differences of evidences, at least one either way: by that the same hypothesis differs from itself by chance."""
    return np.asarray(np.where(gains > 0, 1.0, -1.0) * np.maximum(np.abs(gains), 1.0))


def _with_biases(some: Iterable[Toggle]) -> list[Toggle]:
    """Toggles and what stands for their biases, sorted."""
    found = set(some)
    return sorted(found | {toggle.bias for toggle in found})


def _weights(hypotheses: Sequence[Toggles], every: Sequence[Toggle]) -> Array:
    """Of the errors of toggles and of biases in those of hypotheses, shape (hypotheses, toggles)."""
    at = {toggle: k for k, toggle in enumerate(every)}
    found = np.zeros((len(hypotheses), len(every)))
    for row, some in zip(found, hypotheses, strict=True):
        for toggle in some:
            row[at[toggle]] = 1 / math.sqrt(len(some))
            row[at[toggle.bias]] = 1.0
    return found
