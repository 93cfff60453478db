"""A few steps of an action between which what changes as smoothly as the motion is known.

What an elastic body shows depends on where the gripper is and what loads act, whatever step it is: it is interpolated over these by
a Gaussian process about a parabola, whose squared-exponential kernel is as long as their range, and whose variance says where
another step must be known (Rasmussen & Williams, Gaussian Processes for Machine Learning, 2006, sections 2.2, 2.7 and 4.2;
Krause, Singh & Guestrin, Near-Optimal Sensor Placements in Gaussian Processes, JMLR 2008, for the choice).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.forms.model import Model
from bcid.measurement import Action
from bcid.scene.rotation import as_rotation

Array = NDArray[np.float64]
Steps = NDArray[np.int64]
# Steps are added until the variance of all others is at most this part of that about the parabola, whose own is so many times as
# large.
_KNOWN, _TREND = 1e-3, 10.0
# Turns by less than this, in rad, count for as little as they are.
_TURN = np.radians(10.0)
# The cosine of the least angle that is a turn.
_AHEAD = np.sqrt(0.5)
# Added to the variance of what is known, for the kernel's matrix to be solved with.
_NUGGET = 1e-8


@dataclass(frozen=True)
class Knots:
    """Steps of an action from which all others are interpolated.

    Attributes:
        frames: of the action, shape (steps,).
        steps: that must be known, rising, the first among them.
        weights: of these in every step from the first to the last, shape (last + 1 - first, knots).
        rougher: the same of a process about a straight line whose kernel is half as long.
    """

    frames: Steps
    steps: Steps
    weights: Array
    rougher: Array

    @classmethod
    def of(cls, action: Action, first: int = 0, last: int | None = None, timed: bool = False) -> Knots:
        """Of an action, from one of its steps to another; by default from rest to its end.

        `timed`: what is interpolated is a matter of time as well.
        """
        last = len(action) - 1 if last is None else last
        first = min(first, last)
        way = _way(action)[first : last + 1]
        if timed:
            clock = action.clock[first : last + 1]
            way = np.column_stack([way, clock / max(float(np.ptp(clock)), 1e-12)])
        smooth, rough = _kernel(way, 1.0, 2), _kernel(way, 0.5, 1)
        chosen = _chosen(smooth)
        return cls(action.frames, first + chosen, _weights(smooth, chosen), _weights(rough, chosen))

    def fill(self, values: Array) -> float:
        """Interpolate values (frames, ...) between the steps, in place; after the last nothing changes.

        Returns:
            RMS difference, over what was interpolated, from what the rougher process makes of it.
        """
        first = int(self.steps[0])
        last = first + len(self.weights) - 1
        at = values[self.frames[self.steps]]
        missing = np.setdiff1d(np.arange(first, last + 1), self.steps)
        found = np.tensordot(self.weights[missing - first], at, axes=1)
        apart = (found - np.tensordot(self.rougher[missing - first], at, axes=1))[np.isfinite(found)]
        values[self.frames[missing]] = found
        values[self.frames[last + 1 :]] = values[self.frames[last]]
        return float(np.sqrt(np.mean(apart**2))) if apart.size else 0.0


def _kernel(way: Array, length: float, degree: int) -> Array:
    """Covariance of any two places on the way, about a polynomial, shape (steps, steps)."""
    apart, away = np.square(way[:, None] - way).sum(axis=2), way - way.mean(axis=0)
    return np.asarray(np.exp(-apart / (2 * length**2)) + _TREND * (1 + away @ away.T) ** degree)


def _chosen(kernel: Array) -> Steps:
    """The first step, and one after the other that of which the others say the least."""
    chosen = np.array([0])
    while True:
        known = kernel[chosen]
        variance = np.diag(kernel) - np.einsum("ks,ks->s", known, np.linalg.solve(_within(kernel, chosen), known))
        variance[chosen] = 0.0
        if variance.max() <= _KNOWN:
            return np.sort(chosen)
        chosen = np.append(chosen, variance.argmax())


def _weights(kernel: Array, chosen: Steps) -> Array:
    return np.asarray(np.linalg.solve(_within(kernel, chosen), kernel[chosen]).T)


def _within(kernel: Array, chosen: Steps) -> Array:
    return np.asarray(kernel[np.ix_(chosen, chosen)] + _NUGGET * np.eye(len(chosen)))


def knots_of(
    model: Model, actions: Sequence[Action], frames: NDArray[np.bool_], directed: bool = False
) -> list[Knots] | None:
    """The steps in which what changes as smoothly as the motion need be known besides rest; None where in all that are seen.

    Args:
        model: law and effects: what some of them do changes more suddenly than the motion.
        actions: those without a frame that was followed are left out.
        frames: that were followed, shape (frames,); of each action they are the first.
        directed: whether it depends on where the gripper comes from as well: each stretch up to a turn is then for itself.
    """
    if not all(term.effect.smooth or term.effect.observe for term in model.terms):
        return None
    counts = [int(frames[action.frames].sum()) for action in actions]
    stretches = _stretches if directed else _whole
    ways = ((action, count - 1) for action, count in zip(actions, counts, strict=True) if count)
    return [Knots.of(*stretch) for action, last in ways for stretch in stretches(action, last)]


def _whole(action: Action, last: int) -> list[tuple[Action, int, int]]:
    return [(action, 1, last)]


def _stretches(action: Action, last: int) -> list[tuple[Action, int, int]]:
    """Parts of an action between which it turns, with their first and last step; all but the last end with that."""
    moves = np.diff(_way(action)[: last + 1], axis=0)
    sizes = np.linalg.norm(moves, axis=1)
    moving = np.flatnonzero(sizes)
    ahead = moves[moving] / sizes[moving, None]
    turned = 1 + moving[1:][np.sum(ahead[1:] * ahead[:-1], axis=1) < _AHEAD]
    firsts = [min(1, last), *map(int, turned)]
    ends = [*(first - 1 for first in firsts[1:]), last]
    parts = [action if end == last else action.until(end + 1) for end in ends]
    return list(zip(parts, firsts, ends, strict=True))


def known_frames(known: Sequence[Knots], count: int) -> NDArray[np.bool_]:
    """Rest and the frames of known steps, of so many frames."""
    seen = np.zeros(count, dtype=bool)
    for one in known:
        seen[one.frames[[0, *one.steps]]] = True
    return seen


def _way(action: Action) -> Array:
    """Where the gripper and driven places are, and what loads act, each as part of its range, shape (steps, n).

    A gripper that hardly turns is not taken to turn at random.
    """
    turned = (as_rotation(action.rotation) * as_rotation(action.rotation[0]).inv()).as_rotvec()
    others = [*action.loads.values(), *(moved.reshape(len(moved), -1) for moved in action.boundary.values())]
    way = np.hstack([action.translation, turned, *others])
    ends = np.cumsum([3, 3, *(other.shape[1] for other in others)])
    kinds = [slice(first, end) for first, end in zip([0, *ends], ends, strict=False)]
    for number, kind in enumerate(kinds):
        way[:, kind] /= max(float(np.linalg.norm(np.ptp(way[:, kind], axis=0))), _TURN if number == 1 else 1e-12)
    return way
