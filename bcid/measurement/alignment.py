"""Bringing markers into the body's frame: the rigid motion that fits them best, and whether it can be believed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bcid.base.errors import InputError
from bcid.measurement.slips import FACTORS, rigid_motion

Array = NDArray[np.float64]

# Prior probability that markers to align by were confused, and the certainties above which that is refused or said.
_SLIP, _REFUSED, _SAID = 0.01, 0.99, 0.5
# How well people know where markers stand, part of their span.
_PLACED = 0.01
# A rigid motion that misses its markers by more than this part of their span (RMS) is none; half as much is said.
_LIMIT = 0.2
# A marker further away than this is no marker, in any unit of length.
_FAR = 1e12


@dataclass(frozen=True)
class Alignment:
    """Rotation (3, 3) and shift (3) from the recording's frame to the body's, and what is odd about them."""

    turn: Array
    shift: Array
    rms: float
    remarks: tuple[str, ...]


def align(here: Array, there: Array, names: Sequence[str]) -> Alignment:
    """The rigid motion from markers seen at `here` (n, 3) to where they are said to be, `there` (n, 3), in one unit.

    Raises:
        InputError: they stand on one line, or cannot be brought onto each other.
    """
    span = max(float(np.linalg.norm(np.ptp(there, axis=0))), 1e-300)
    if (np.abs(here) > _FAR * span).any():
        raise InputError(
            f"marker {names[int(np.abs(here).max(axis=1).argmax())]} is absurdly far away in the first frame"
        )
    sizes = np.linalg.svd((here - here.mean(axis=0)).T @ (there - there.mean(axis=0)), compute_uv=False)
    if sizes[1] < 1e-9 * sizes[0]:
        raise InputError("its markers stand on one line; choose others")
    turn, shift = rigid_motion(here, there)
    rms = _misfit(here, there)
    remarks: list[str] = []
    told = f"the rigid motion misses its markers by {rms:.3g} (RMS distance), where they span {span:.3g}"
    chance, text = _confused(here, there, names, span)
    if chance > _REFUSED:
        raise InputError(f"{told}: {text}")
    if chance > _SAID:
        remarks.append(f"align: {told}: {text}")
    elif rms > _LIMIT * span:
        raise InputError(
            f"{told}: check the places and the markers, which must be those of the first frame, and length_unit"
        )
    elif rms > 0.5 * _LIMIT * span:
        remarks.append(f"align: {told}")
    return Alignment(turn, shift, rms, tuple(remarks))


def _misfit(here: Array, there: Array) -> float:
    """RMS distance that the best rigid motion leaves."""
    turn, shift = rigid_motion(here, there)
    return float(np.sqrt(np.mean(np.sum((here @ turn.T + shift - there) ** 2, axis=1))))


def _confused(here: Array, there: Array, names: Sequence[str], span: float) -> tuple[float, str]:
    """With what probability the markers were confused, and how; the scale of the misfit is not known."""
    tried = list(_confusions(here, there, names))
    count = 3 * len(here) - 6
    left = [_misfit(here, there), *(misfit for _, misfit in tried)]
    evidence = np.array([-0.5 * count * math.log(misfit**2 + (_PLACED * span) ** 2) for misfit in left])
    prior = [math.log1p(-_SLIP), *([math.log(_SLIP / len(tried))] * len(tried))]
    posterior = np.exp(evidence + prior - logsumexp(evidence + prior))
    best = int(posterior[1:].argmax())
    return float(1 - posterior[0]), tried[best][0]


def _confusions(here: Array, there: Array, names: Sequence[str]) -> Iterator[tuple[str, float]]:
    for i, j in itertools.combinations(range(len(here)), 2):
        order = list(range(len(here)))
        order[i], order[j] = j, i
        yield f"markers {names[i]} and {names[j]} look swapped", _misfit(here[order], there)
    for factor in FACTORS:
        many = f"{factor:g} times too small" if factor > 1 else f"{1 / factor:g} times too large"
        yield f"the places of [align] look {many}: they are in length_unit", _misfit(here, there * factor) / factor
    yield "the axes look reversed (another handedness): write one of them with the other sign", _misfit(-here, there)
