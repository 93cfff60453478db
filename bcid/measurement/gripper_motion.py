"""Whether the fiducials near a grasp go where the gripper goes: frames and units of the gripper's poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import softmax

from bcid.measurement.slips import FACTORS, permutations

if TYPE_CHECKING:
    from bcid.scene.action import Action

Array = NDArray[np.float64]

# So many fiducials nearest to a grasp are looked at.
_NEAREST = 3
# They follow by a part of the gripper's motion: about this one, within this factor (log-normal), and hardly ever by more than all.
_FOLLOW, _FOLLOW_SPREAD, _MOST = 0.6, 0.8, 1.25
# A grip that gives, and fiducials that anchors hold: so often they hardly move, by this part of the gripper's motion.
_LOOSE, _STILL = 0.1, 0.1
# So often a pull is of another kind altogether.
_UNUSUAL = 0.01
# The gripper goes by about this part of the body's size, within this factor (log-normal).
_PULL, _PULL_SPREAD = 0.15, 0.9
# What the body does across the pull, part of the motion: no rigid following is better than that.
_ACROSS = 0.08
# Of a smooth motion three numbers tell something for each direction that the gripper goes in, and for a bend; so many at most.
_MOST_NUMBERS = 15.0


@dataclass(frozen=True)
class GripperPoses:
    """Poses of the gripper, beside where fiducials at `rest` (n, 3) and the centres of grasps are in the scene.

    `size` is that of the body, `noise` the standard deviation of a coordinate; all in m.
    """

    actions: Sequence[Action]
    rest: Array
    centres: Mapping[str, Array]
    size: float
    noise: float

    def slip(self, positions: Array, prior: float) -> tuple[float, str]:
        """With what probability something is wrong with the poses, by positions (frames, n, 3), and what it looks like.

        Args:
            positions: of the fiducials; without any near a grasp nothing is wrong.
            prior: probability of a slip.
        """
        pulls = self._pulls(positions)
        if not pulls:
            return 0.0, ""
        text, axes = "all lengths look {:g} times too {}".format, permutations()
        sizes = [text(f, "large") if f > 1 else text(1 / f, "small") for f in FACTORS]
        factors: list[tuple[str, Array]] = [
            (s, np.diag(np.full(3, 1.0 / f))) for s, f in zip(sizes, FACTORS, strict=True)
        ]
        tried = [("", np.eye(3)), *axes, *factors]
        known = [math.log1p(-prior)] + [math.log(prior / 2 / len(kind)) for kind in (axes, factors) for _ in kind]
        shares = softmax(
            np.array([_evidence(pulls, undo, self.size, self.noise) for _, undo in tried]) + np.array(known)
        )
        order = np.argsort(-shares[1:], kind="stable")[:3] + 1
        texts = [tried[i][0] for i in order if shares[i] > 0.2 * shares[order[0]]]
        return float(1 - shares[0]), " or ".join(texts)

    def mended_by(self, undo: Array, mended: Array, noise: float) -> bool | None:
        """Whether what mends positions (frames, n, 3), `undo` (3, 3), mends the poses too; None where that is not told."""
        pulls = self._pulls(mended)
        if not pulls:
            return None
        alike = _evidence(pulls, undo, self.size, noise) - _evidence(pulls, np.eye(3), self.size, noise)
        # Odds of 10 are enough for a remark.
        return None if abs(alike) < math.log(10.0) else bool(alike > 0)

    def _pulls(self, positions: Array) -> list[_Pull]:
        found = []
        for action in self.actions:
            seen = positions[action.frames]
            whole = np.flatnonzero(np.isfinite(seen).all(axis=(0, 2)))
            if not action.grasp or not action.translation.any() or not len(whole):
                continue
            arms = self.rest[whole] - self.centres[action.grasp]
            near = np.argsort(np.linalg.norm(arms, axis=1), kind="stable")[:_NEAREST]
            here = np.clip(seen[:, whole[near]], -1e9, 1e9)
            translation = np.clip(action.translation, -1e9, 1e9)
            found.append(_Pull(here - here[0], arms[near], translation, action.rotation))
        return found


@dataclass(frozen=True)
class _Pull:
    """Fiducials near a grasp: displacement since step 0 (steps, k, 3), arms from its centre (k, 3), and the gripper's motion."""

    moved: Array
    arms: Array
    translation: Array
    rotation: Array


def _evidence(pulls: Sequence[_Pull], undo: Array, size: float, noise: float) -> float:
    """Logarithm of the likelihood of the fiducials' motion with the gripper's poses mended by `undo` (3, 3)."""
    left, parts, moves, furthest = [], [], [], 0.0
    for pull in pulls:
        driven = _driven(pull, undo)
        # Of two steps no noise can be told: where none is known either, it may be as large as the motion.
        known = noise > 0 or len(pull.moved) > 2
        spread = max(noise, _roughness(pull.moved)) if known else float(np.abs(pull.moved).max())
        most = max(float(np.sum(driven**2)), 1e-300)
        follow = float(np.sum(driven * pull.moved)) / most
        # An error of the first step is in all others.
        unsure = spread * float(np.sum(np.abs(driven))) / most
        low, high = (min(max(follow + way * unsure, 1e-4), 1e4) for way in (-1, 1))
        part = min(max(follow, 1e-4), _MOST)
        scale = float(np.mean(pull.moved**2))
        missed = float(np.mean((pull.moved - part * driven) ** 2))
        left.append((missed + spread**2) / (scale + spread**2) + _ACROSS**2)
        parts.append(math.log(min(max(_FOLLOW, low), high)))
        moves.append(math.sqrt(max(scale - 2 * spread**2, 0.0) * driven.size / most))
        furthest = max(furthest, float(np.abs(pull.translation @ undo.T).max()))
    count = min(3 * (1.0 + sum(_ways(pull.translation) for pull in pulls)), _MOST_NUMBERS)
    misfit = -0.5 * count * float(np.mean(np.log(left)))
    follow = (float(np.mean(parts)) - math.log(_FOLLOW)) / _FOLLOW_SPREAD
    reach = (math.log(furthest / size) - math.log(_PULL)) / _PULL_SPREAD if furthest > 0 else 0.0
    # A small pull is no oddity.
    loose = math.log(_LOOSE) - 0.5 * min(float(np.mean(moves)) / _STILL, 1e3) ** 2
    usual = float(np.logaddexp(-0.5 * follow**2, loose))
    usual += float(np.logaddexp(-0.5 * max(reach, 0.0) ** 2, math.log(_UNUSUAL)))
    return misfit + usual


def _ways(translation: Array) -> float:
    """In how many directions a path (steps, 3) goes: from 1, a straight one, to 3, the whole space (participation ratio)."""
    sizes = np.linalg.svd(translation / np.abs(translation).max(), compute_uv=False)
    return float(np.sum(sizes) ** 2 / np.sum(sizes**2))


def _roughness(moved: Array) -> float:
    """Noise of a coordinate as its second differences over the steps tell, m; a path with corners has a little more."""
    if len(moved) < 3:
        return 0.0
    return float(np.sqrt(np.mean(np.diff(moved, n=2, axis=0) ** 2) / 6.0))


def _driven(pull: _Pull, undo: Array) -> Array:
    """Where the gripper would carry the fiducials if they were fixed to it, shape (steps, k, 3), from rest."""
    # Axes of another frame turn the axis of a rotation too; a mirror reverses it.
    turn = undo / np.cbrt(abs(np.linalg.det(undo)))
    vectors = Rotation.from_quat(pull.rotation[:, [1, 2, 3, 0]]).as_rotvec() @ turn.T * np.sign(np.linalg.det(turn))
    turned = Rotation.from_rotvec(vectors).as_matrix() @ pull.arms.T
    return np.asarray(np.swapaxes(turned, 1, 2) - pull.arms + (pull.translation @ undo.T)[:, None])
