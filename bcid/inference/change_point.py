"""Something begins: a force at one place, from some frame of an action on.

An unknown force that is smooth (`bcid.inference.discrepancy`) stands for what is spread over the body and goes on with the
motion. What tears, sticks or lets go at a spot does neither: it begins, and moves what is near. It has three numbers, and a place
and a frame that nobody knows: all are as likely, so that what chance shows in one of so many is paid for. Only the jump counts: a
force at the same place that is there all the time, and changes as a parabola of the gripper's way, may act besides with any size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, softmax

from bcid.inference.data import Data
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.evidence import LARGER, LinearParameters, gains_of
from bcid.inference.priors import PRIORS, spaced
from bcid.inference.thresholds import THRESHOLDS

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
# What differs from a smooth force by less than this part of its square does not begin.
_LIKE_SMOOTH = 1e-6


@dataclass(frozen=True)
class ChangePoint:
    """By when something has begun.

    What tears while little pulls on it shows later, when more does, and a force at one place stands for what it does anywhere near:
    neither from when on nor where it acts is told.

    Attributes:
        by: the frame in which it acts, with `Thresholds.credible`.
        log: logarithm of how much likelier it makes the data than nothing, with all that it may be counted.
    """

    by: int
    log: float


class ChangePointForce:
    """A force at one of many places that acts from one of many frames on.

    It stays as it is or grows with the gripper's way, to the end of its action or of the measurement. Before it begins its action
    was seen in motion, and two frames show it: what is there all the time does not begin, nor what a single frame shows.

    Args:
        errors: of all else.
        slopes: movement per unit of the force at each place in each frame, shape (n, places, 3), m.
    """

    def __init__(self, errors: ErrorCovariance, slopes: Array) -> None:
        data = errors.data
        self._errors = errors
        self._scaled = slopes / errors.sigma[:, None, None]
        self._frames, self._row = np.unique(data.frame, return_inverse=True)
        self._begins, self._sudden, self._smooth = _courses(data, self._frames)
        squares, self._beside, smooth = self._products()
        scale = np.sqrt(np.maximum(np.diagonal(smooth, axis1=1, axis2=2), 1e-300))
        both = scale[:, :, None] * scale[:, None, :]
        self._inverse = np.linalg.inv(smooth / both + np.eye(smooth.shape[1]) / PRIORS.sudden_sizes[1] ** 2) / both
        jumps = squares - self._beside @ self._inverse @ np.swapaxes(self._beside, 2, 3)
        size, whole = (np.trace(some, axis1=2, axis2=3) / 3 for some in (jumps, squares))
        self._told = size > _LIKE_SMOOTH * whole
        self._unit = np.sqrt(np.where(self._told, size, 1.0))[:, :, None, None]
        self._jumps = jumps / self._unit**2

    def beginning(self, residual: Array, numbers: LinearParameters) -> ChangePoint | None:
        """By when, by a residual (n,), m, at numbers that are unknown besides; None where no frame could show it."""
        if not self._told.any():
            return None
        gains = self._gains(residual, numbers)
        begins = np.broadcast_to(self._begins[:, None], self._told.shape)[self._told]
        until = np.cumsum(np.bincount(begins, softmax(gains)))
        by = self._frames[min(int(np.searchsorted(until, THRESHOLDS.credible)), len(until) - 1)]
        return ChangePoint(int(by), float(logsumexp(gains) - np.log(len(gains))))

    def _gains(self, residual: Array, numbers: LinearParameters) -> Array:
        """How much likelier each that is told from a smooth one makes the data, as logarithms.

        The unknown numbers have the middle one of the widths that they may have.
        """
        errors, width = self._errors, numbers.widths[len(numbers.widths) // 2]
        known = np.column_stack([errors.whiten(residual) + numbers.columns @ numbers.apart, numbers.columns * width])
        weighed = errors.weighed(known)
        each = self._by_frame(np.arange(len(weighed)), weighed)
        smooth = _flat(np.tensordot(self._smooth, each, 1))
        products = known.T @ known - np.swapaxes(smooth, 1, 2) @ self._inverse @ smooth
        with_known = (np.tensordot(self._sudden, each, 1) - self._beside @ self._inverse @ smooth) / self._unit
        inverse = np.linalg.inv(np.eye(len(width)) + products[:, 1:, 1:])
        left = with_known[..., 1:] @ inverse
        rj = with_known[..., :1] - left @ products[:, 1:, :1]
        jj = self._jumps - left @ np.swapaxes(with_known[..., 1:], 2, 3)
        sizes, free = np.repeat(spaced(PRIORS.sudden_sizes)[:, None], 3, axis=1), np.zeros(3, dtype=bool)
        rr, factors = float(known[:, 0] @ known[:, 0]), None if errors.data.stated else LARGER
        return gains_of(rr, rj[self._told, :, 0], jj[self._told], len(residual), sizes, free, factors)

    def _products(self) -> tuple[Array, Array, Array]:
        """Products with the inverse of the covariance of forces at a place, in units of the noise.

        Of each that begins with itself, (sudden, places, 3, 3), with the smooth ones, (sudden, places, 3, k), and of these with
        each other, (places, k, k).
        """
        rows = [np.flatnonzero(self._row == k) for k in range(len(self._frames))]
        own = np.array([np.einsum("npa,npb->pab", self._scaled[some], self._scaled[some]) for some in rows])
        squares = np.tensordot(self._sudden**2, own, 1)
        beside = np.tensordot(self._sudden[:, None] * self._smooth, own, 1).transpose(0, 2, 3, 1, 4)
        smooth = np.tensordot(self._smooth[:, None] * self._smooth, own, 1).transpose(2, 0, 3, 1, 4)
        count = 3 * len(self._smooth)
        beside, smooth = beside.reshape(*beside.shape[:3], count), smooth.reshape(len(smooth), count, count)
        for some, columns in self._errors.explaining():
            each = self._by_frame(some, columns)
            sudden, others = np.tensordot(self._sudden, each, 1), _flat(np.tensordot(self._smooth, each, 1))
            squares -= sudden @ np.swapaxes(sudden, 2, 3)
            beside -= sudden @ np.swapaxes(others, 1, 2)
            smooth = smooth - others @ np.swapaxes(others, 1, 2)
        return squares, beside, smooth

    def _by_frame(self, rows: Rows, columns: Array) -> Array:
        """Products of a force in each frame with columns (rows, k) of some rows, in units of the noise, (frames, places, 3, k)."""
        forces, row = self._scaled[rows].reshape(len(rows), -1), self._row[rows]
        each = [forces[row == k].T @ columns[row == k] for k in range(len(self._frames))]
        return np.reshape(each, (len(each), *self._scaled.shape[1:], columns.shape[1]))


def _courses(data: Data, frames: Rows) -> tuple[Rows, Array, Array]:
    """How large forces are in the frames that are seen: of those that begin when they do, and how large, and of smooth ones.

    Shapes (sudden,), (sudden, frames) and (smooth, frames).
    """
    _, rows = np.unique(data.frame, return_index=True)
    action, moving, way = data.action[rows], data.step[rows] > 0, data.way[rows]
    number = np.arange(len(frames))
    found = []
    for course in (np.ones(len(frames)), way):
        for begin in number:
            after = number >= begin
            for acts in (after & (action == action[begin]), after):
                # What one frame alone shows is no beginning.
                if np.any((moving & (action == action[begin]))[:begin]) and acts.sum() > 1:
                    found.append((begin, acts * course))
    smooth = np.array([np.ones(len(frames)), way, way**2])
    begins = np.array([begin for begin, _ in found], dtype=np.int64)
    return begins, np.array([sizes for _, sizes in found]).reshape(-1, len(frames)), smooth


def _flat(each: NDArray[Any]) -> Array:
    """Of products (forces, places, 3, k) those at each place, (places, 3 forces, k)."""
    return np.asarray(each.transpose(1, 0, 2, 3).reshape(each.shape[1], 3 * len(each), each.shape[3]))
