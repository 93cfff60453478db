"""Something begins: a force at one place, from some frame of an action on.

An unknown force that is smooth (`bcid.inference.unknown_force`) stands for what is spread over the body and goes on with the
motion. What tears, sticks or lets go at a spot does neither: it begins, and moves what is near. It has three numbers, and a place
and a frame that nobody knows: all are as likely, so that what chance shows in one of so many is paid for. Only the jump counts: a
force at the same place that was there before, and changes smoothly with the gripper's way, may act besides with any size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, softmax

from bcid.inference.criteria import CERTAIN, SEEN
from bcid.inference.evidence import LARGER, Numbers, gains_of
from bcid.inference.likelihood import Errors

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
# Standard deviations of the force that are equally likely, in those that the data leave of it: from what is just seen on.
_SIZES: Array = SEEN * np.logspace(0, 3, 7)
# Powers of the gripper's way that are smooth.
_SMOOTH = 3
# What differs from a smooth force by less than this part of its square does not begin.
_LIKE_SMOOTH = 1e-6


@dataclass(frozen=True)
class Beginning:
    """By when something has begun.

    What tears while little pulls on it shows later, when more does, and a force at one place stands for what it does anywhere near:
    neither from when on nor where it acts is told.

    Attributes:
        by: the frame in which it acts, with `CERTAIN`.
        log: logarithm of how much likelier it makes the data than nothing, with all that it may be counted.
    """

    by: int
    log: float


class SuddenForce:
    """A force at one of many places that acts from one of many frames on.

    It stays as it is or grows with the gripper's way, to the end of its action or of the measurement. Before it begins its action
    was seen in motion, and two frames show it: what is there all the time does not begin, nor what a single frame shows.

    Args:
        errors: of all else.
        slopes: movement per unit of the force at each place in each frame, shape (n, places, 3), m.
    """

    def __init__(self, errors: Errors, slopes: Array) -> None:
        data = errors.data
        self._errors = errors
        self._frames, self._row = np.unique(data.frame, return_inverse=True)
        self._of_frame = [np.flatnonzero(self._row == k) for k in range(len(self._frames))]
        action = np.array([data.action[rows[0]] for rows in self._of_frame])
        end = np.array([np.flatnonzero(action == a)[-1] + 1 for a in action])
        moving = np.array([data.step[rows[0]] > 0 for rows in self._of_frame])
        begins = np.array([k for k, a in enumerate(action) if moving[:k][action[:k] == a].any()], dtype=np.int64)
        # Each acts in the frames from one up to another; what one frame alone shows is no beginning.
        spans = [(begins, end[begins]), (begins, np.full_like(begins, len(action)))]
        self._spans = [(begin[until > begin + 1], until[until > begin + 1]) for begin, until in spans]
        scaled = slopes / errors.sigma[:, None, None]
        powers = [data.way[:, None, None] ** power * scaled for power in range(_SMOOTH)]
        self._courses = powers[:2]
        self._smooth = _Smooth.of(errors, np.concatenate(powers, axis=2))
        squares = self._squares()
        self._beside = self._sums(self._smooth.weighed)
        jumps = squares - self._beside @ self._smooth.inverse @ np.swapaxes(self._beside, 2, 3)
        size, whole = (np.trace(some, axis1=2, axis2=3) / 3 for some in (jumps, squares))
        self._told = size > _LIKE_SMOOTH * whole
        self._unit = np.sqrt(np.where(self._told, size, 1.0))[:, :, None, None]
        self._jumps = jumps / self._unit**2

    def beginning(self, residual: Array, numbers: Numbers) -> Beginning | None:
        """By when, by a residual (n,), m, at numbers that are unknown besides; None where no frame could show it."""
        if not self._told.any():
            return None
        gains = self._gains(residual, numbers)
        begins = np.concatenate([begin for begin, _ in self._spans] * len(self._courses))
        begins = np.broadcast_to(begins[:, None], self._told.shape)[self._told]
        until = np.cumsum(np.bincount(begins, softmax(gains)))
        by = self._frames[min(int(np.searchsorted(until, CERTAIN)), len(until) - 1)]
        return Beginning(int(by), float(logsumexp(gains) - np.log(len(gains))))

    def _gains(self, residual: Array, numbers: Numbers) -> Array:
        """How much likelier each that is told from a smooth one makes the data, as logarithms.

        The unknown numbers have the middle one of the widths that they may have.
        """
        errors, width = self._errors, numbers.widths[len(numbers.widths) // 2]
        known = np.column_stack([errors.whiten(residual) + numbers.columns @ numbers.apart, numbers.columns * width])
        weighed = errors.weighed(known)
        smooth = self._smooth.along(weighed)
        products = known.T @ known - np.swapaxes(smooth, 1, 2) @ self._smooth.inverse @ smooth
        repeated = np.repeat(weighed[:, None], self._told.shape[1], axis=1)
        with_known = (self._sums(repeated) - self._beside @ self._smooth.inverse @ smooth) / self._unit
        inverse = np.linalg.inv(np.eye(len(width)) + products[:, 1:, 1:])
        left = with_known[..., 1:] @ inverse
        rj = with_known[..., :1] - left @ products[:, 1:, :1]
        jj = self._jumps - left @ np.swapaxes(with_known[..., 1:], 2, 3)
        sizes, free = np.repeat(_SIZES[:, None], 3, axis=1), np.zeros(3, dtype=bool)
        rr, factors = float(known[:, 0] @ known[:, 0]), None if errors.data.stated else LARGER
        return gains_of(rr, rj[self._told, :, 0], jj[self._told], len(residual), sizes, free, factors)

    def _sums(self, values: Array) -> Array:
        """Products of each force with values (n, places, m), in units of the noise: shape (beginnings, places, 3, m)."""
        found = []
        for course in self._courses:
            until = _until([np.einsum("npa,npb->pab", course[rows], values[rows]) for rows in self._of_frame])
            found += [until[end] - until[begin] for begin, end in self._spans]
        return np.concatenate(found)

    def _squares(self) -> Array:
        """Products of the components of each force with the inverse of the covariance: shape (beginnings, places, 3, 3)."""
        parts = list(self._errors.explaining())
        found = []
        for course in self._courses:
            own = _until([np.einsum("npa,npb->pab", course[rows], course[rows]) for rows in self._of_frame])
            shared = [_until(self._shares(course, rows, columns)) for rows, columns in parts]
            for begin, end in self._spans:
                squares = own[end] - own[begin]
                for share in shared:
                    along = share[end] - share[begin]
                    squares = squares - along @ np.swapaxes(along, 2, 3)
                found.append(squares)
        return np.concatenate(found)

    def _shares(self, course: Array, rows: Rows, columns: Array) -> list[Array]:
        """Products of each force in each frame with columns (rows, k) of some rows, each (places, 3, k)."""
        row = self._row[rows]
        return [course[rows[row == k]].transpose(1, 2, 0) @ columns[row == k] for k in range(len(self._of_frame))]


@dataclass(frozen=True)
class _Smooth:
    """A force at each place that is there all the time and changes smoothly with the gripper's way, of any size.

    Attributes:
        columns: what it does, in units of the noise, shape (n, places, k).
        weighed: the same times the inverse of the covariance.
        inverse: of the products of both beside its own size, shape (places, k, k).
    """

    columns: Array
    weighed: Array
    inverse: Array

    @classmethod
    def of(cls, errors: Errors, columns: Array) -> _Smooth:
        """Of columns (n, places, k), in units of the noise."""
        flat = (columns * errors.sigma[:, None, None]).reshape(len(columns), -1)
        weighed = errors.weighed(errors.whiten(flat)).reshape(columns.shape)
        squares = np.einsum("npa,npb->pab", columns, weighed)
        scale = np.sqrt(np.maximum(np.diagonal(squares, axis1=1, axis2=2), 1e-300))
        both = scale[:, :, None] * scale[:, None, :]
        inverse = np.linalg.inv(squares / both + np.eye(columns.shape[2]) / _SIZES[-1] ** 2) / both
        return cls(columns, weighed, inverse)

    def along(self, weighed: Array) -> Array:
        """Products with values (n, m) that are weighed: shape (places, k, m)."""
        return np.einsum("npa,nm->pam", self.columns, weighed, optimize=True)


def _until(each: Sequence[Array]) -> Array:
    """Sums over the first frames, of none to all."""
    return np.concatenate([np.zeros_like(each[0])[None], np.cumsum(each, axis=0)])
