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
from scipy.spatial.distance import cdist
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
    rng = np.random.default_rng(random_state)
    with np.errstate(divide="ignore"):
        logs = np.log(probabilities)
    counts = [max(2, int(np.ceil(samples * p))) if p > 0 else 0 for p in probabilities]
    noise = [_paired_noise(rng, count, every.shape[1]) for count in counts]
    gains = (
        _of_points(every, noise, logs) if len(every) == len(predictions) else _of_clouds(every, columns, noise, logs)
    )
    bits, variance = 0.0, 0.0
    for values, p in zip(gains, probabilities, strict=True):
        if len(values):
            bits += p * float(values.mean())
            variance += p**2 * _variance_of_mean(values)
    return Expected(max(float(bits), 0.0), float(np.sqrt(variance)))


def _paired_noise(rng: np.random.Generator, count: int, size: int) -> Array:
    """So many draws or one more, in pairs of opposite sign; shape (samples, size)."""
    half = rng.normal(size=((count + 1) // 2, size))
    return np.concatenate([half, -half])


def _variance_of_mean(values: Array) -> float:
    """Noise comes in pairs of opposite sign, whose means are independent."""
    pairs = values.reshape(2, -1).mean(axis=0)
    return float(pairs.var(ddof=1)) / len(pairs) if len(pairs) > 1 else float(np.ptp(values)) ** 2


def _of_points(centres: Array, noise: Sequence[Array], logs: Array) -> list[Array]:
    """Bits that each draw tells where every hypothesis is a point with noise about it; all draws at once.

    Of |c_j + n - c_k|^2 the noise's own square is the same for all k.
    """
    squares = cdist(centres, centres, "sqeuclidean")
    ends = np.cumsum([len(own) for own in noise])
    drawn = np.repeat(np.arange(len(centres)), [len(own) for own in noise])
    shifts = np.concatenate(list(noise)) @ centres.T
    shifts -= shifts[np.arange(len(drawn)), drawn][:, None]
    bits = -_log_sum(logs - 0.5 * squares[drawn] + shifts) / np.log(2)
    return np.split(bits, ends[:-1])


def _of_clouds(every: Array, columns: Sequence[Array], noise: Sequence[Array], logs: Array) -> list[Array]:
    """The same where hypotheses have numbers that are not known, cloud by cloud."""
    centres, rest = every[: len(columns)], every[len(columns) :]
    ends = np.cumsum([len(c) for c in columns])[:-1]
    clouds = [_Cloud.of(c, own) for c, own in zip(centres, np.split(rest, ends), strict=True)]
    found = []
    for cloud, own in zip(clouds, noise, strict=True):
        seen = cloud.drawn(own)
        mixture = _log_sum(logs + np.column_stack([other.log_density(seen) for other in clouds]))
        found.append((cloud.log_density(seen) - mixture) / np.log(2))
    return found


def _log_sum(rows: Array) -> Array:
    """Logarithm of the sum of exponentials of each row."""
    top = rows.max(axis=1)
    return np.asarray(top + np.log(np.exp(rows - top[:, None]).sum(axis=1)))


def noise_free(predictions: Array, probabilities: Array) -> Expected:
    """Information of a pull if each prediction were seen as it is: the greedy expected entropy of section 4 of the paper."""
    places = coordinates(predictions)
    squares = cdist(places, places, "sqeuclidean")
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
