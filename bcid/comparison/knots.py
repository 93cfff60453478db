"""A few steps of an action between which what changes smoothly along it is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.measurement import Action
from bcid.scene.rotation import as_rotation

Array = NDArray[np.float64]
Steps = NDArray[np.int64]
# Stretches of the gripper's way are straight up to this part of its reach.
_STRAIGHT = 0.3


def spread(count: int, steps: int) -> Steps:
    """The first of so many, and `steps` more up to the last, evenly spread."""
    return np.unique(np.linspace(0, count - 1, steps + 1).round().astype(int))


@dataclass(frozen=True)
class Knots:
    """Steps of an action: both ends of each stretch of its way that is straight, and the middle of it.

    Attributes:
        frames: of the action, shape (steps,).
        ends: ends of the stretches, rising.
        steps: the ends and what is between them, rising.
    """

    frames: Steps
    ends: Steps
    steps: Steps

    @classmethod
    def of(cls, action: Action, first: int = 0, last: int | None = None) -> Knots:
        """Of an action, from one of its steps to another; by default from rest to its end."""
        last = len(action) - 1 if last is None else last
        first = min(first, last)
        ends = np.unique([first, last])
        way = _way(action)
        while len(ends) <= last - first:
            between = np.arange(first, last + 1)
            straight = np.column_stack([np.interp(between, ends, column[ends]) for column in way.T])
            apart = np.abs(straight - way[first : last + 1]).max(axis=1, initial=0.0)
            if apart.max() <= _STRAIGHT:
                break
            ends = np.union1d(ends, first + int(apart.argmax()))
        return cls(action.frames, ends, np.union1d(ends, (ends[:-1] + ends[1:] + 1) // 2))

    def fill(self, values: Array) -> float:
        """Interpolate values (frames, ...) between the steps, in place; after the last nothing changes.

        Returns:
            RMS difference, over what was interpolated, of the parabolas through ends and middles from straight lines through both.
        """
        squares, count = 0.0, 0
        for a, b in zip(self.ends[:-1], self.ends[1:], strict=True):
            known = self.steps[(self.steps >= a) & (self.steps <= b)]
            missing = np.setdiff1d(np.arange(a, b + 1), known)
            if not len(missing):
                continue
            at = values[self.frames[known]]
            curved = np.tensordot(_lagrange(known, missing), at, axes=1)
            straight = np.tensordot(_linear(known, missing), at, axes=1)
            values[self.frames[missing]] = curved
            apart = (curved - straight)[np.isfinite(curved)]
            squares, count = squares + float(apart @ apart), count + apart.size
        values[self.frames[self.steps[-1] + 1 :]] = values[self.frames[self.steps[-1]]]
        return float(np.sqrt(squares / max(count, 1)))


def _way(action: Action) -> Array:
    """Where the gripper is and what loads act, each as part of its range, shape (steps, n)."""
    turned = (as_rotation(action.rotation) * as_rotation(action.rotation[0]).inv()).as_rotvec()
    way = np.hstack([action.translation, turned, *action.loads.values()])
    kinds = [slice(0, 3), slice(3, 6), *(slice(k, k + 3) for k in range(6, way.shape[1], 3))]
    for kind in kinds:
        way[:, kind] /= max(float(np.linalg.norm(np.ptp(way[:, kind], axis=0))), 1e-12)
    return way


def _lagrange(known: Steps, wanted: Steps) -> Array:
    """Weights of the polynomial through the known steps, shape (wanted, known)."""
    others = [np.delete(known, k) for k in range(len(known))]
    return np.array([[np.prod((w - o) / (k - o)) for k, o in zip(known, others, strict=True)] for w in wanted])


def _linear(known: Steps, wanted: Steps) -> Array:
    return np.column_stack([np.interp(wanted, known, row) for row in np.eye(len(known))])
