"""Slips that are made when a measurement is written down: of fiducials at rest, and of single numbers between steps.

A slip is weighed by what is left of the displacement from the scene's rest positions once it is undone.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

Array = NDArray[np.float64]

# Units that are taken for one another: mm and m, cm and mm, cm and m, inch and mm; decimal points that were lost.
FACTORS = (1000.0, 100.0, 10.0, 25.4, 1e-3, 1e-2, 0.1, 1 / 25.4)
DECIMALS = tuple(10.0**k for k in range(-6, 7) if k)
# Fiducials whose displacement is unlike that of their neighbours the most: only these are tried for swaps and decimals.
_SUSPECTS = 16
_AXES = "xyz"
# The kind of what is no slip of writing, but a marker that is elsewhere: a body has such, and it is never refused.
FAULT = "fault"
# How steps differ from what their neighbours let expect: a t distribution with so many degrees of freedom ...
_TAIL = 6.0
# ... whose scale is the noise, this part of the body's size, and this part of how far things move in the step.
_PART, _MOVED = 0.002, 0.3
# Lengths above this, m, are taken for it: their squares must be numbers.
_FAR = 1e9


@dataclass(frozen=True)
class Slip:
    """A slip, and what is left when it is undone.

    Attributes:
        kind: what the slips that share a prior probability have in common.
        text: what it looks like.
        remedy: what to do about it.
        left: displacements of the fiducials from rest once it is undone, shape (n, 3), m.
        cost: logarithm of the prior probability within the kind, and of the density that positions have which were stretched so.
        undo: what positions are multiplied by to undo it, shape (3, 3); None where it concerns single fiducials.
    """

    kind: str
    text: str
    remedy: str
    left: Array
    cost: float
    undo: Array | None = None


def slips(seen: Array, rest: Array, names: Sequence[str], size: float, floor: float) -> list[Slip]:
    """Every slip of the list, for fiducials at `seen` (n, 3) that should be near `rest` (n, 3).

    Args:
        size: of the body; `floor`: how well positions are known, both in m, as the positions are.
    """
    odd, whole = suspects(seen - rest, rest), np.isfinite(seen).all()
    found = [*_axes(seen, rest)] if whole else []
    found += [*_factors(seen, rest), *_swaps(seen, rest, names, odd)]
    found += [*_renamed(seen, rest, names), *_turned(seen, rest, size, floor)] if whole else []
    return [*found, *_decimals(seen, rest, names, odd), *_faults(seen, rest, names, odd, size, floor)]


def permutations() -> list[tuple[str, Array]]:
    """The 47 ways to mix up or reverse the axes: in words, and the matrix that undoes it."""
    found: list[tuple[str, Array]] = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if not np.array_equal(matrix, np.eye(3)):
                found.append((_axis_text(order, signs), matrix.T))
    return found


def _axis_text(order: Sequence[int], signs: Sequence[float]) -> str:
    moved = [i for i in range(3) if order[i] != i]
    reversed_ = [i for i in range(3) if signs[i] < 0]
    if len(moved) == 2 and not reversed_:
        return f"{_AXES[moved[0]]} and {_AXES[moved[1]]} look swapped"
    if not moved:
        return f"{' and '.join(_AXES[i] for i in reversed_)} look{'s' if len(reversed_) == 1 else ''} reversed"
    held = ", ".join(f"{'-' if s < 0 else ''}{_AXES[i]}" for i, s in zip(order, signs, strict=True))
    return f"axes look mixed up: columns x, y, z hold {held} of the scene"


def _axes(seen: Array, rest: Array) -> Iterator[Slip]:
    remedy = "write the positions in the axes of the scene"
    for text, undo in permutations():
        yield Slip("axes", text, remedy, seen @ undo.T - rest, -math.log(47), undo)


def _factors(seen: Array, rest: Array) -> Iterator[Slip]:
    """All lengths, or those of one axis, times a factor."""
    for factor in FACTORS:
        many = f"{factor:g} times too large" if factor > 1 else f"{1 / factor:g} times too small"
        undo: Array = np.diag(np.full(3, 1.0 / factor))
        # What is stretched fills more room: without this any field would look smaller, and likelier, when it is shrunk.
        # The other way round there is nothing to gain: a coordinate that is zero stays so whatever it is multiplied by.
        dense = -max(0.0, math.log(factor)) * len(rest)
        cost = 3 * dense - math.log(16)
        yield Slip("units", f"all positions look {many}", "check length_unit", seen / factor - rest, cost, undo)
        for axis in np.flatnonzero(np.isfinite(seen).any(axis=0)):
            part = np.ones(3)
            part[axis] /= factor
            text = f"every {_AXES[axis]} looks {many}"
            remedy = "check length_unit and the decimal points of that column"
            yield Slip("units", text, remedy, seen * part - rest, dense - math.log(16 * 3), np.diag(part))


def _swaps(seen: Array, rest: Array, names: Sequence[str], odd: Sequence[int]) -> Iterator[Slip]:
    pairs = len(rest) * (len(rest) - 1) / 2
    for i, j in itertools.combinations(sorted(odd), 2):
        left = seen - rest
        left[[i, j]] = seen[[j, i]] - rest[[i, j]]
        text = f"fiducials {names[i]} and {names[j]} look swapped"
        yield Slip("swaps", text, "give each its own name", left, -math.log(pairs))


def _renamed(seen: Array, rest: Array, names: Sequence[str]) -> Iterator[Slip]:
    """The fiducials in another order, each nearest to where the scene has it."""
    if len(rest) < 3:
        return
    distance = np.linalg.norm(rest[:, None] - seen[None], axis=2)
    order = linear_sum_assignment(distance)[1]
    moved = [i for i in range(len(rest)) if order[i] != i]
    if len(moved) > 2:
        shown = ", ".join(f"{names[order[i]]} stands where {names[i]} should" for i in moved[:4])
        text = f"{len(moved)} fiducials look as if they had each other's names ({shown}{', ...' if moved[4:] else ''})"
        cost = -len(moved) * math.log(len(rest))
        yield Slip("order", text, "number them as the scene does", seen[order] - rest, cost)


def _turned(seen: Array, rest: Array, size: float, floor: float) -> Iterator[Slip]:
    """Another frame: what a rigid motion leaves. Its six numbers pay for how finely they must be chosen."""
    if len(rest) < 4:
        return
    turn, shift = rigid_motion(seen, rest)
    angle = np.degrees(np.linalg.norm(Rotation.from_matrix(turn).as_rotvec()))
    moved = np.linalg.norm((seen - rest).mean(axis=0)) / size
    text = f"the axes are not those of the scene: a frame that is turned by {angle:.0f} degrees, {moved:.2g} body sizes away"
    remedy = "bring the positions into the frame of the scene (a mapping file with [align] does it)"
    yield Slip("frame", text, remedy, seen @ turn.T + shift - rest, -6 * math.log(size / floor))


def _decimals(seen: Array, rest: Array, names: Sequence[str], odd: Sequence[int]) -> Iterator[Slip]:
    same = -math.log(len(rest) * 3 * len(DECIMALS))
    for i, axis, factor in itertools.product(odd, range(3), DECIMALS):
        if not np.isfinite(seen[i, axis]):
            continue
        left = seen - rest
        left[i, axis] = seen[i, axis] * factor - rest[i, axis]
        text = f"{_AXES[axis]} of fiducial {names[i]} looks as if its decimal point were lost or misplaced"
        yield Slip("decimals", text, "check its decimal point", left, same + min(0.0, math.log(factor)))


def _faults(
    seen: Array, rest: Array, names: Sequence[str], odd: Sequence[int], size: float, floor: float
) -> Iterator[Slip]:
    """One fiducial that is anywhere else: no slip of the list, but what competes with those of single fiducials."""
    cost = -math.log(len(rest)) - 3 * math.log(2 * size / floor)
    near = _near(rest)
    for i in odd:
        left = seen - rest
        expected = np.nanmedian(np.where(np.isfinite(left[near[i]]), left[near[i]], 0.0), axis=0)
        away = float(np.linalg.norm(np.nan_to_num(left[i]) - expected))
        left[i] = expected
        text = f"fiducial {names[i]} is {away * 1e3:.3g} mm from where its neighbours let expect it"
        yield Slip(FAULT, text, "check its place in the scene and its name", left, cost)


def _near(rest: Array) -> NDArray[np.intp]:
    """Of each fiducial, itself and its nearest neighbours, shape (n, k)."""
    count = min(7, len(rest))
    return np.asarray(cKDTree(rest).query(rest, k=count)[1]).reshape(len(rest), count)


def suspects(moved: Array, rest: Array) -> list[int]:
    """Fiducials whose displacement (n, 3) is unlike their neighbours', the worst first; few of them."""
    near = _near(rest)
    rough = np.linalg.norm(np.nan_to_num(moved - np.median(moved[near], axis=1)), axis=1)
    return [int(i) for i in np.argsort(-rough, kind="stable")[:_SUSPECTS]]


def rigid_motion(here: Array, there: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3) that take points `here` (n, 3) to `there` (n, 3) best: least squares (Kabsch 1976)."""
    middle, wanted = here.mean(axis=0), there.mean(axis=0)
    left, _, right = np.linalg.svd((here - middle).T @ (there - wanted))
    turn = (right.T * [1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))]) @ left.T
    return turn, wanted - turn @ middle


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
        value, least, most = (float(one[k, i, axis]) for one in (positions, low, high))
        spread = float(scale[k, 0, 0])
        none, other = _log_t(float(away[k, i, axis]), spread), prior - math.log(2.0 * size)
        misses = [float(_outside(np.float64(value * factor), least, most)) for factor in DECIMALS]
        mended = [_log_t(miss, spread) - math.log(len(DECIMALS)) + prior for miss in misses]
        total = float(logsumexp([none, other, *mended]))
        probability = -math.expm1(none - total)
        if probability > 0.5:
            best = int(np.argmax(mended))
            factor = DECIMALS[best] if mended[best] > other else None
            expected = 0.5 * (least + most)
            found.append(Jump(int(k), int(i), int(axis), value, expected, probability, factor))
    return found


def _outside(value: Array | np.float64, low: Array | float, high: Array | float) -> Array:
    """How far a value is outside an interval; NaN where it is not known."""
    return np.asarray(np.maximum(np.maximum(value - high, low - value), 0.0))


def _beside(positions: Array) -> tuple[Array, Array]:
    """Positions one seen step before and after, shape (steps, points, 3); at an end that is the only one there is."""
    found = []
    for seen in (positions, positions[::-1]):
        beside = np.full_like(seen, np.nan)
        for k in range(1, len(seen)):
            beside[k] = np.where(np.isfinite(seen[k - 1]), seen[k - 1], beside[k - 1])
        found.append(beside)
    return found[0], found[1][::-1]


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
