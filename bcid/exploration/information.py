"""How much a pull is expected to tell: bits of information about which hypothesis is true.

With predictions mu_h, probabilities p_h and Gaussian errors the measurement y is a mixture, and the information of the
pull is I = sum_h p_h E[log2 p(y|h) / sum_k p_k p(y|k)], y ~ p(.|h): it is estimated from samples, with a standard error.
Boonvisut & Cavusoglu (2014), section 4, take the entropy that is left if each prediction were seen as it is, without noise:
`noise_free`.

A hypothesis with numbers that are not known predicts mu_h + B_h z, with z ~ N(0, 1) and a column of B_h for each of them.

Only differences of predictions matter. In units of their errors they, and the columns, lie in a space of few dimensions, in
which the noise is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

Array = NDArray[np.float64]
# A direction in which all predictions agree this well (in units of the error) tells nothing.
_SEEN = 1e-2


@dataclass(frozen=True)
class Expected:
    """Information that a pull is expected to give, bits, and the standard error of the estimate."""

    bits: float
    error: float = 0.0


def coordinates(predictions: Array) -> Array:
    """Predictions (hypotheses, values), in units of their errors, in few coordinates with the same distances."""
    return _together(predictions - predictions.mean(axis=0))


def _together(rows: Array) -> Array:
    """Rows in few coordinates with the same products."""
    sizes, vectors = np.linalg.eigh(rows @ rows.T)
    seen = sizes > _SEEN**2
    return np.asarray(vectors[:, seen] * np.sqrt(sizes[seen]))


@dataclass(frozen=True)
class _Cloud:
    """What a hypothesis may show, in few coordinates: a Gaussian."""

    centre: Array
    root: Array

    @classmethod
    def of(cls, centre: Array, columns: Array) -> _Cloud:
        """Noise of size one, and columns (numbers, coordinates)."""
        return cls(centre, np.asarray(np.linalg.cholesky(np.eye(len(centre)) + columns.T @ columns)))

    def drawn(self, noise: Array) -> Array:
        """Places from noise (samples, coordinates)."""
        return np.asarray(self.centre + noise @ self.root.T)

    def log_density(self, places: Array) -> Array:
        """Of places (samples, coordinates), up to a constant that all clouds share."""
        apart = np.linalg.solve(self.root, (places - self.centre).T)
        return np.asarray(-0.5 * np.sum(apart**2, axis=0) - np.sum(np.log(np.diag(self.root))))


def information(
    predictions: Array, probabilities: Array, samples: int, random_state: int, loose: Sequence[Array] | None = None
) -> Expected:
    """Information of a pull.

    Args:
        predictions: shape (hypotheses, values), in units of their errors (see `Errors.whiten`).
        probabilities: shape (hypotheses,), summing to one.
        samples: how many measurements are drawn, shared among the hypotheses by their probabilities; two for each at least.
        random_state: of the noise. Pulls are compared with the same noise.
        loose: of each hypothesis, what its unknown numbers change in one standard deviation, shape (numbers, values).
    """
    columns = [np.zeros((0, predictions.shape[1]))] * len(predictions) if loose is None else list(loose)
    every = _together(np.vstack([predictions - predictions.mean(axis=0), *columns]))
    if every.shape[1] == 0:
        return Expected(0.0)
    centres, rest = every[: len(predictions)], every[len(predictions) :]
    ends = np.cumsum([len(c) for c in columns])[:-1]
    clouds = [_Cloud.of(c, own) for c, own in zip(centres, np.split(rest, ends), strict=True)]
    rng = np.random.default_rng(random_state)
    with np.errstate(divide="ignore"):
        logs = np.log(probabilities)
    bits, variance = 0.0, 0.0
    for cloud, p in zip(clouds, probabilities, strict=True):
        if p <= 0:
            continue
        count = max(2, int(np.ceil(samples * p)))
        half = rng.normal(size=((count + 1) // 2, every.shape[1]))
        seen = cloud.drawn(np.concatenate([half, -half]))
        mixture = logsumexp(logs + _densities(clouds, seen), axis=1)
        values = (cloud.log_density(seen) - mixture) / np.log(2)
        bits += p * float(values.mean())
        # Noise comes in pairs of opposite sign, whose means are independent.
        pairs = values.reshape(2, -1).mean(axis=0)
        variance += (
            p**2 * float(pairs.var(ddof=1)) / len(pairs) if len(pairs) > 1 else p**2 * float(np.ptp(values)) ** 2
        )
    return Expected(max(float(bits), 0.0), float(np.sqrt(variance)))


def _densities(clouds: Sequence[_Cloud], places: Array) -> Array:
    """Logarithms of the densities of all clouds at some places, shape (places, clouds)."""
    identity = np.eye(places.shape[1])
    if all(np.array_equal(cloud.root, identity) for cloud in clouds):
        centres = np.array([cloud.centre for cloud in clouds])
        return np.asarray(-0.5 * np.sum((places[:, None, :] - centres[None, :, :]) ** 2, axis=2))
    return np.column_stack([cloud.log_density(places) for cloud in clouds])


def noise_free(predictions: Array, probabilities: Array) -> Expected:
    """Information of a pull if each prediction were seen as it is: the greedy expected entropy of section 4 of the paper."""
    places = coordinates(predictions)
    squares = np.sum((places[:, None, :] - places[None, :, :]) ** 2, axis=2)
    with np.errstate(divide="ignore"):
        logs = np.log(probabilities)
    posterior = logs - 0.5 * squares
    posterior -= logsumexp(posterior, axis=1, keepdims=True)
    left = float(np.sum(probabilities * _entropy(posterior)))
    return Expected(max(float(_entropy(logs[None, :])[0]) - left, 0.0))


def _entropy(logs: Array) -> Array:
    """Entropy in bits of each row of logarithms of probabilities."""
    p = np.exp(logs)
    return np.asarray(-np.sum(np.where(p > 0, p * logs, 0.0), axis=1) / np.log(2))
