"""Coordinates that jump away between steps and back: lost decimal points, and points taken for others."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bcid.measurement.slips import DECIMALS

Array = NDArray[np.float64]

# How steps differ from what their neighbours let expect: a t distribution with so many degrees of freedom ...
_TAIL = 6.0
# ... whose scale is the noise, this part of the body's size, and this part of how far things move in the step.
_PART, _MOVED = 0.002, 0.3
# Lengths above this, m, are taken for it: their squares must be numbers.
_FAR = 1e9


@dataclass(frozen=True)
class Jump:
    """A coordinate that is not what the steps beside it let expect.

    Attributes:
        step, point, axis: where it is.
        value, expected: what is there, and what is expected, m.
        probability: that something is wrong with it.
        factor: what it is to be multiplied by when a decimal point was misplaced; None where that is no explanation.
    """

    step: int
    point: int
    axis: int
    value: float
    expected: float
    probability: float
    factor: float | None


def jumps(positions: Array, gripper: Array, noise: float, size: float, slip: float) -> list[Jump]:
    """Jumps of coordinates in positions (steps, points, 3) of one action, m.

    Args:
        gripper: how far the gripper moves from each step to the next, shape (steps - 1,), m.
        noise: standard deviation of a coordinate; `size`: of the body, m.
        slip: prior probability that one of all coordinates is wrong.
    """
    if len(positions) < 3:
        return []
    # What is further away is no further from being right.
    positions = np.clip(positions, -_FAR, _FAR)
    before, after = _beside(positions)
    low, high = np.fmin(before, after), np.fmax(before, after)
    scale = _scale(positions, gripper, max(noise, _roughness(positions)), size)[:, None, None]
    away = _outside(positions, low, high)
    prior = math.log(slip / positions.size)
    # What is within a few scales is looked at no further.
    found = []
    for k, i, axis in np.argwhere(np.nan_to_num(away / scale) > 5.0):
        here = float(positions[k, i, axis]), float(low[k, i, axis]), float(high[k, i, axis]), float(scale[k, 0, 0])
        none = _log_t(float(away[k, i, axis]), here[3])
        other = prior - math.log(2.0 * size)
        mended = [
            _log_t(float(_outside(np.float64(here[0] * f), here[1], here[2])), here[3])
            - math.log(len(DECIMALS))
            + prior
            for f in DECIMALS
        ]
        total = float(logsumexp([none, other, *mended]))
        probability = -math.expm1(none - total)
        if probability > 0.5:
            best = int(np.argmax(mended))
            factor = DECIMALS[best] if mended[best] > other else None
            expected = 0.5 * (here[1] + here[2])
            found.append(Jump(int(k), int(i), int(axis), here[0], expected, probability, factor))
    return found


def _outside(value: Array | np.float64, low: Array | float, high: Array | float) -> Array:
    """How far a value is outside an interval; NaN where it is not known."""
    return np.asarray(np.maximum(np.maximum(value - high, low - value), 0.0))


def _beside(positions: Array) -> tuple[Array, Array]:
    """Positions one seen step before and after, shape (steps, points, 3); at an end that is the only one there is."""
    before, after = np.full_like(positions, np.nan), np.full_like(positions, np.nan)
    for k in range(1, len(positions)):
        before[k] = np.where(np.isfinite(positions[k - 1]), positions[k - 1], before[k - 1])
    for k in range(len(positions) - 2, -1, -1):
        after[k] = np.where(np.isfinite(positions[k + 1]), positions[k + 1], after[k + 1])
    return before, after


def _roughness(positions: Array) -> float:
    """Noise of a coordinate as the median of its second differences over the steps tells, m: single jumps do not count."""
    bends = np.abs(np.diff(positions, n=2, axis=0))
    known = bends[np.isfinite(bends)]
    # Of a normal distribution half is within 0.6745 deviations; a second difference has six variances.
    return float(np.median(known)) / (0.6745 * math.sqrt(6.0)) if len(known) > 5 else 0.0


def _scale(positions: Array, gripper: Array, noise: float, size: float) -> Array:
    """How far a coordinate may be from what its neighbours let expect, shape (steps,), m."""
    change = np.abs(np.diff(positions, axis=0))
    seen = np.isfinite(change).any(axis=(1, 2))
    typical = np.zeros(len(change))
    # A point that was not seen in both steps says nothing; of one, some axes alone may be known.
    furthest = np.where(np.isnan(change[seen]), -np.inf, change[seen]).max(axis=2)
    typical[seen] = np.nanmedian(np.where(np.isfinite(furthest), furthest, np.nan), axis=1)
    if positions.shape[1] == 1:
        # A single point has no neighbours: what it does in all steps tells.
        typical[:] = np.median(typical)
    moves = np.maximum(typical, gripper)
    padded = np.concatenate([[0.0], moves, [0.0]])
    largest = np.maximum(padded[:-1], padded[1:])
    # At the ends there is one neighbour only: the whole motion may be missing.
    factors = np.full(len(positions), _MOVED)
    factors[[0, -1]] = 1.0
    return np.asarray(noise + _PART * size + factors * largest)


def _log_t(value: float, scale: float) -> float:
    """Logarithm of the density of a t distribution."""
    normal = math.lgamma((_TAIL + 1) / 2) - math.lgamma(_TAIL / 2) - 0.5 * math.log(_TAIL * math.pi) - math.log(scale)
    return normal - 0.5 * (_TAIL + 1) * math.log1p((value / scale) ** 2 / _TAIL)
