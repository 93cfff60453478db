"""The posterior: probabilities of hypotheses whose evidences are known at different fidelities.

An evidence is exact where a hypothesis was fitted to all steps. A lower fidelity knows it against a hypothesis k that was, and errs
in their difference: by a factor where that is large, by a few nats where it is small. The error is a sum over the T patches and
effects in which the two differ, with one term for each, shared by all hypotheses with that toggle:

    P(h | d) = E_u [Z_h(u) p(h) / sum_j Z_j(u) p(j)],
    log Z_h(u) = min(C, l_k + F(a sinh(arsinh(G(l_h - l_k) / a) + b + s sum_t u_t / sqrt(T)))),                           (2)
    F(x) = R (1 - exp(-x / R)) for x > 0, else x,     G the inverse of F,     R = C - l_k + a,

where C is the evidence of a hypothesis that explains all: the more of a misfit is explained, the more it takes to explain what
is left. That is so of tangents; of fits to a few steps F is the identity. Of a tangent in a few steps l_h is in turn such a
sum. a is a few nats; with the errors of another set it is larger by what a discrepancy explains, times the square of the part
by which movements told with that set are off: the columns of its errors are as much off, and leave so much of it.
With errors of their own some of thousands of unlikely hypotheses would always be drawn as likely. Bias and scale are
learned from the pairs of fidelities that a run has, apart for patches and effects and for gains and losses: with a normal-
inverse-gamma prior b and s u_t have a multivariate Student distribution with four degrees of freedom, and one more for each
pair (Gelman et al., Bayesian Data Analysis, 3rd ed. 2013, section 14.8). A pair that misses by more counts less (Lange et al.,
J. Am. Stat. Assoc. 84, 1989, 881).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
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
# An error that makes any hypothesis impossible.
_LARGEST = 50.0
# Rounds of reweighting, after which the errors of heavy tails change no more.
_ROUNDS = 10


class Fidelity(IntEnum):
    """How an evidence below the full fidelity is known: linearised, in a few steps, or in all with the errors of another."""

    TANGENT = 0
    COARSE = 1
    SHARED = 2


class Kind(NamedTuple):
    """What has errors of the same size: toggled patches or effects, at a fidelity, that gain or lose by it."""

    fidelity: Fidelity
    effect: bool
    gains: bool


class Toggle(NamedTuple):
    """A patch or an effect in which two hypotheses differ, at a fidelity below the full one.

    Attributes:
        kind, name: which error it has.
        sign: of the error: of a few steps it is that of adding the patch or effect, -1 where it is taken away.
    """

    kind: Kind
    name: str
    sign: int = 1

    @property
    def error(self) -> Toggle:
        """What stands for its error, whatever the sign."""
        return self._replace(sign=1)

    @property
    def bias(self) -> Toggle:
        """What stands for the error that all of its kind have in common."""
        return self._replace(name="", sign=1)


Toggles = tuple[Toggle, ...]
# Where each toggle of the pairs of a kind is; mean and scale matrix of their errors; factor of all variances; degrees of freedom.
_Learned = tuple[dict[Toggle, int], Array, Array, float, float]


def toggles(fidelity: Fidelity, one: Hypothesis, other: Hypothesis, gain: float) -> Toggles:
    """In which a hypothesis differs from another, whose evidence it exceeds by so much in the logarithm; sorted.

    A tangent is about the other; in a few steps both are known alike, and what one gains the other loses.
    """
    names, others = set(one.names), set(other.names)
    added = {(False, patch) for patch in one.anchors - other.anchors} | {(True, effect) for effect in names - others}
    taken = {(False, patch) for patch in other.anchors - one.anchors} | {(True, effect) for effect in others - names}
    alike = fidelity == Fidelity.COARSE
    # What gains was chosen among many for what it seemed to gain: it has errors of its own.
    gains = (gain > 0) != (alike and len(taken) > len(added))
    signs = dict.fromkeys(added, 1) | dict.fromkeys(taken, -1 if alike else 1)
    return tuple(sorted(Toggle(Kind(fidelity, effect, gains), name, sign) for (effect, name), sign in signs.items()))


class FidelityStep(NamedTuple):
    """From a lower fidelity to a higher one, by a hypothesis that is known at both.

    Attributes:
        low, high: logarithm of the evidence of that one, at either.
        toggles: in which it differs from the one that is known at the lower only.
        room: by how much more evidence one has that explains all than the one that is known at both, where a tangent tells.
        nats: the difference a of equation (2) below which an error is one of so many nats.
    """

    low: float
    high: float
    toggles: Toggles
    room: float = math.inf
    nats: float = PRIORS.error_nats


@dataclass(frozen=True)
class Evaluation:
    """What is known of a hypothesis.

    Attributes:
        start: logarithm of its evidence at the fidelity at which it is known.
        log_prior: logarithm of its prior odds.
        steps: from that fidelity to the full one; none where it is known there.
        about: the hypothesis whose tangent tells of it, or whose errors it has, if one does.
    """

    start: float
    log_prior: float
    steps: tuple[FidelityStep, ...] = ()
    about: Hypothesis | None = None

    @property
    def log(self) -> float:
        """Logarithm of its evidence at the full fidelity, as it is expected."""
        return self._raised(self.start, self.steps)

    @staticmethod
    def _raised(log: float, steps: Iterable[FidelityStep]) -> float:
        return log + math.fsum(step.high - step.low for step in steps)

    @property
    def toggles(self) -> Toggles:
        """Whose errors it has."""
        return tuple(toggle for step in self.steps for toggle in step.toggles)

    @property
    def fidelity(self) -> Fidelity:
        """The lowest on the way; the highest below the full one where nothing is toggled."""
        return min((toggle.kind.fidelity for toggle in self.toggles), default=Fidelity.SHARED)

    def order(self, known: Mapping[Hypothesis, float]) -> tuple[int, float, int]:
        """The better of two that are known of a hypothesis comes first: without a tangent, or else about what fits best.

        What a tangent says is the more exact the less it leaves to be explained. `known` are logarithms of evidences.
        """
        about = self.log
        if self.about:
            about = known.get(self.about, self._raised(self.steps[0].high, self.steps[1:]))
        return -self.fidelity, -about, len(self.toggles)

    def at_most(self, log: float) -> Evaluation:
        """The same with no more evidence."""
        *steps, last = self.steps
        return replace(self, steps=(*steps, last._replace(high=last.high - max(self.log - log, 0.0))))


@dataclass(frozen=True)
class Pair:
    """A hypothesis that is known at two fidelities.

    Attributes:
        toggles: in which it differs from the one that the lower fidelity knows it against.
        low, high: by how much the logarithm of its evidence exceeds that one's, at either.
        room: by how much more evidence one has that explains all than that one, where a tangent tells.
        nats: as of a `FidelityStep`.
    """

    toggles: Toggles
    low: float
    high: float
    room: float = math.inf
    nats: float = PRIORS.error_nats

    @property
    def kind(self) -> Kind:
        """Whose error it tells."""
        return min((toggle.kind for toggle in self.toggles), key=lambda kind: (kind.fidelity, not kind.effect))

    @property
    def failed(self) -> bool:
        """Whether the fit of an added effect failed: as small as one likes, it costs no more than its Occam factor."""
        kind = self.kind
        return kind.effect and kind.fidelity == Fidelity.TANGENT and self.high < -PRIORS.failed_fit

    @property
    def miss(self) -> float:
        """The error of the difference, see equation (2).

        Of a gain that turned into a loss nothing was left.
        """
        high = max(self.high, 0.0) if self.low > 0 else self.high
        low, high = unlimited(np.array([self.low, high]), self.room, self.nats) / self.nats
        return float(np.arcsinh(high) - np.arcsinh(low))


class Posterior:
    """Equation (2).

    Args:
        evaluations: of each hypothesis.
        pairs: from which the errors of the fidelities are learned, but for fits that failed.
        ceiling: logarithm of the evidence of a hypothesis that explains all.
    """

    def __init__(
        self, evaluations: Mapping[Hypothesis, Evaluation], pairs: Iterable[Pair] = (), ceiling: float = math.inf
    ) -> None:
        self.evaluations = dict(evaluations)
        self.pairs = [
            pair for pair in pairs if pair.toggles and math.isfinite(pair.low + pair.high) and not pair.failed
        ]
        self.ceiling = ceiling
        self._learned: dict[Kind, _Learned] = {}

    def probabilities(self) -> dict[Hypothesis, float]:
        """Of each hypothesis, the most probable first; they sum to one."""
        if not self.evaluations:
            return {}
        known = list(self.evaluations.values())
        every = _with_biases(toggle for one in known for toggle in one.toggles)
        start, prior = np.array([one.start for one in known]), np.array([one.log_prior for one in known])
        errors, shares = self.errors(every), np.zeros(len(known))
        steps = [_step(known, k, every) for k in range(max(len(one.steps) for one in known))]
        exact = np.array([not one.steps for one in known])
        for part in np.array_split(errors, math.ceil(len(errors) * len(known) / _AT_A_TIME)):
            logs: Array = np.repeat(start[None], len(part), axis=0)
            for low, high, room, nats, weights in steps:
                missed = with_error(logs - low, part @ weights.T, room, nats)
                logs = high + np.where(weights.any(axis=1), missed, logs - low)
            logs = np.where(exact, start, np.minimum(logs, self.ceiling))
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

    def expected(self, some: Toggles) -> float:
        """The error of the difference of two hypotheses that is expected after the pairs."""
        every = tuple(_with_biases(some))
        means = np.array([self.learned(toggle.kind, (toggle,))[0][0] for toggle in every])
        return float(np.sum(_weights([some], every) @ means)) if every else 0.0

    def learned(self, kind: Kind, wanted: Toggles) -> tuple[Array, Array, float]:
        """Of the errors of toggles of a kind, given its pairs.

        Returns:
            Their mean, shape (k,), a root of their scale matrix, (k, k), and their degrees of freedom. Of a pair with toggles of
            several kinds the error is taken to be that of the lowest fidelity, and of effects before patches.
        """
        if kind not in self._learned:
            self._learned[kind] = self._learn(kind)
        known, means, covariances, surprise, freedom = self._learned[kind]
        # What no pair tells has the prior, but for the scale that all of its kind have.
        mean, covariance = np.zeros(len(wanted)), surprise * _scale(kind) ** 2 * np.eye(len(wanted))
        here = [k for k, toggle in enumerate(wanted) if toggle in known]
        there = [known[wanted[k]] for k in here]
        mean[here], covariance[np.ix_(here, here)] = means[there], covariances[np.ix_(there, there)]
        values, vectors = np.linalg.eigh(covariance)
        return mean, vectors * np.sqrt(np.maximum(values, 0.0)), freedom

    def _learn(self, kind: Kind) -> _Learned:
        """Of the toggles of the pairs of a kind."""
        pairs = [pair for pair in self.pairs if pair.kind == kind]
        own = [tuple(toggle for toggle in pair.toggles if toggle.kind == kind) for pair in pairs]
        every = _with_biases(toggle for some in own for toggle in some)
        scale, freedom, surprise = _scale(kind), PRIORS.error_freedom, 1.0
        mean, covariance = np.zeros(len(every)), scale**2 * np.eye(len(every))
        if pairs:
            design, misses = _weights(own, every), np.array([pair.miss for pair in pairs])
            prior, weights = covariance, np.ones(len(pairs))
            for _ in range(_ROUNDS):
                # What toggles do together is as uncertain as what each does, and has as heavy tails.
                expected = design @ prior @ design.T + scale**2 * np.diag(1 / weights)
                gain = np.linalg.solve(expected, design @ prior).T
                squares = float(misses @ np.linalg.solve(expected, misses))
                surprise, mean = (freedom + squares) / (freedom + len(pairs)), gain @ misses
                apart = (misses - design @ mean) ** 2 / (surprise * scale**2)
                weights = (freedom + 1) / (freedom + apart)
            covariance = surprise * (prior - gain @ design @ prior)
            freedom += len(pairs)
        return {toggle: k for k, toggle in enumerate(every)}, mean, covariance, surprise, freedom


def _scale(kind: Kind) -> float:
    """Of errors of a kind before any pair."""
    patches, effects, coarse, shared = PRIORS.fidelity_error
    tangent = effects if kind.effect else patches
    return {Fidelity.TANGENT: tangent, Fidelity.COARSE: coarse, Fidelity.SHARED: shared}[kind.fidelity]


def with_error(
    gains: Array, errors: Array, room: Array | float = math.inf, nats: Array | float = PRIORS.error_nats
) -> Array:
    """Differences of log evidences with errors, see equation (2); elementwise. `room` is C - l_k, `nats` is a."""
    sizes = np.arcsinh(unlimited(gains, room, nats) / nats) + np.clip(errors, -_LARGEST, _LARGEST)
    return _limited(nats * np.sinh(np.clip(sizes, -_LARGEST, _LARGEST)), room, nats)


def unlimited(gains: Array, room: Array | float, nats: Array | float = PRIORS.error_nats) -> Array:
    """G of equation (2): what gains would be if what there is to explain had no end; elementwise."""
    whole = np.asarray(room) + nats
    with np.errstate(invalid="ignore"):
        free = np.where(np.isfinite(whole), -whole * np.log1p(-np.minimum(gains, room) / whole), gains)
    return np.where(gains > 0, free, gains)


def _limited(free: Array, room: Array | float, nats: Array | float) -> Array:
    """F of equation (2), elementwise."""
    whole = np.asarray(room) + nats
    with np.errstate(invalid="ignore", over="ignore"):
        gains = np.where(np.isfinite(whole), -whole * np.expm1(-free / whole), free)
    return np.where(free > 0, gains, free)


def _step(known: Sequence[Evaluation], number: int, every: Sequence[Toggle]) -> tuple[Array, ...]:
    """Of each evaluation the step of a number, or none: low, high, room and nats, (k,), and weights of errors, (k, toggles)."""
    nothing = FidelityStep(0.0, 0.0, ())
    steps = [one.steps[number] if number < len(one.steps) else nothing for one in known]
    numbers = ("low", "high", "room", "nats")
    low, high, room, nats = (np.array([getattr(step, name) for step in steps]) for name in numbers)
    return low, high, np.maximum(room, 0.0), nats, _weights([step.toggles for step in steps], every)


def _with_biases(some: Iterable[Toggle]) -> list[Toggle]:
    """What stands for the errors of toggles and for their biases, sorted."""
    found = set(some)
    return sorted({toggle.error for toggle in found} | {toggle.bias for toggle in found})


def _weights(hypotheses: Sequence[Toggles], every: Sequence[Toggle]) -> Array:
    """Of the errors of toggles and of biases in those of hypotheses, shape (hypotheses, toggles)."""
    at = {toggle: k for k, toggle in enumerate(every)}
    found = np.zeros((len(hypotheses), len(every)))
    for row, some in zip(found, hypotheses, strict=True):
        for toggle in some:
            row[at[toggle.error]] = toggle.sign / math.sqrt(len(some))
            row[at[toggle.bias]] += toggle.sign / sum(other.kind == toggle.kind for other in some)
    return found
