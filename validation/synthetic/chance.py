"""Random numbers of the hidden study: they depend on a key alone."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

Rng = np.random.Generator
T = TypeVar("T")


def generator(*key: int) -> Rng:
    """Random numbers that depend on the key alone."""
    return np.random.default_rng(np.random.SeedSequence(list(key)))


def log_uniform(rng: Rng, lower: float, upper: float) -> float:
    """Any number between two, its logarithm uniform."""
    return float(np.exp(rng.uniform(np.log(lower), np.log(upper))))


def in_turn(choices: tuple[T, ...], turn: int, *key: int) -> T:
    """The choices in a new order each round."""
    cycle, place = divmod(turn, len(choices))
    return choices[generator(*key, cycle).permutation(len(choices))[place]]
