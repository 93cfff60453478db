"""Something begins: a force at one place, from some frame of an action on.

An unknown force that is smooth (`bcid.inference.unknown_force`) stands for what is spread over the body and goes on with the
motion. What tears, sticks or lets go at a spot does neither: it begins, and moves what is near. It has three numbers, and a place
and a frame that nobody knows: all are as likely, so that what chance shows in one of so many is paid for.
"""

from __future__ import annotations

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


@dataclass(frozen=True)
class Beginning:
    """When something begins. Where is not told: what tears pulls on both sides, and a force at one place stands for that anywhere.

    Attributes:
        first, last: frames between which it does, with `CERTAIN`.
        log: logarithm of how much likelier it makes the data than nothing, with all that it may be counted.
    """

    first: int
    last: int
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
        self._errors, self._places = errors, slopes.shape[1]
        self._frames, self._row = np.unique(data.frame, return_inverse=True)
        self._of_frame = [np.flatnonzero(self._row == k) for k in range(len(self._frames))]
        action = np.array([data.action[rows[0]] for rows in self._of_frame])
        end = np.array([np.flatnonzero(action == a)[-1] + 1 for a in action])
        moving = np.array([data.step[rows[0]] > 0 for rows in self._of_frame])
        begins = np.array([k for k, a in enumerate(action) if moving[:k][action[:k] == a].any()], dtype=np.int64)
        # Each acts in the frames from one up to another; what one frame alone shows is no beginning.
        spans = [(begins, end[begins]), (begins, np.full_like(begins, len(action)))]
        self._spans = [(begin[until > begin + 1], until[until > begin + 1]) for begin, until in spans]
        scaled = (slopes / errors.sigma[:, None, None]).reshape(len(data), -1)
        self._courses = [scaled, data.way[:, None] * scaled]
        squares = self._squares()
        self._unit = np.sqrt(np.maximum(np.trace(squares, axis1=1, axis2=2) / 3, 1e-300))
        self._unlike = squares / self._unit[:, None, None] ** 2

    def beginning(self, residual: Array, numbers: Numbers) -> Beginning | None:
        """When, by a residual (n,), m, at numbers that are unknown besides; None where no frame could show it."""
        if not len(self._unit):
            return None
        gains = self._gains(residual, numbers)
        begins = np.concatenate([np.repeat(begin, self._places) for begin, _ in self._spans] * len(self._courses))
        until = np.cumsum(np.bincount(begins, softmax(gains)))
        ends = np.searchsorted(until, [(1 - CERTAIN) / 2, (1 + CERTAIN) / 2]).clip(max=len(until) - 1)
        first, last = self._frames[ends]
        return Beginning(int(first), int(last), float(logsumexp(gains) - np.log(len(gains))))

    def _gains(self, residual: Array, numbers: Numbers) -> Array:
        """How much likelier each makes the data, as logarithms.

        The unknown numbers have the middle one of the widths that they may have.
        """
        errors, width = self._errors, numbers.widths[len(numbers.widths) // 2]
        known = np.column_stack([errors.whiten(residual) + numbers.columns @ numbers.apart, numbers.columns * width])
        products = known.T @ known
        with_known = self._along(errors.weighed(known)) / self._unit[:, None, None]
        inverse = np.linalg.inv(np.eye(len(width)) + products[1:, 1:])
        left = with_known[:, :, 1:] @ inverse
        rr = float(products[0, 0] - products[0, 1:] @ inverse @ products[1:, 0])
        rj = with_known[:, :, 0] - left @ products[1:, 0]
        jj = self._unlike - left @ with_known[:, :, 1:].transpose(0, 2, 1)
        free = np.zeros(3, dtype=bool)
        sizes = np.repeat(_SIZES[:, None], 3, axis=1)
        return gains_of(rr, rj, jj, len(residual), sizes, free, None if errors.data.stated else LARGER)

    def _along(self, values: Array) -> Array:
        """Products of each force with values (n, m), in units of the noise: shape (forces, 3, m)."""
        found = []
        for course in self._courses:
            until = _until(np.array([course[rows].T @ values[rows] for rows in self._of_frame]))
            found += [(until[end] - until[begin]).reshape(-1, 3, values.shape[1]) for begin, end in self._spans]
        return np.concatenate(found)

    def _squares(self) -> Array:
        """Products of the components of each force with each other, with the inverse of the covariance: shape (forces, 3, 3)."""
        parts = list(self._errors.explaining())
        found = []
        for course in self._courses:
            shape = len(self._of_frame), self._places, 3, 3
            each = np.zeros(shape)
            for k, rows in enumerate(self._of_frame):
                here = course[rows].reshape(len(rows), self._places, 3)
                each[k] = np.einsum("npa,npb->pab", here, here)
            own = _until(each)
            shared = [_until(self._shares(course, rows, columns)) for rows, columns in parts]
            for begin, end in self._spans:
                squares = own[end] - own[begin]
                for share in shared:
                    along = (share[end] - share[begin]).transpose(0, 2, 3, 1)
                    squares = squares - along @ along.transpose(0, 1, 3, 2)
                found.append(squares.reshape(-1, 3, 3))
        return np.concatenate(found)

    def _shares(self, course: Array, rows: Rows, columns: Array) -> Array:
        """Products of columns (rows, k) of some rows with each force in each frame, shape (frames, k, places, 3)."""
        each = np.zeros((len(self._of_frame), columns.shape[1], course.shape[1]))
        row = self._row[rows]
        for k in np.unique(row):
            here = row == k
            each[k] = columns[here].T @ course[rows[here]]
        return each.reshape(*each.shape[:2], self._places, 3)


def _until(each: Array) -> Array:
    """Sums over the first frames, of none to all."""
    return np.concatenate([np.zeros_like(each[:1]), np.cumsum(each, axis=0)])
