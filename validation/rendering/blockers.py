"""What may stand between a camera and a point: the body, the gripper, instruments, other beads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from validation.rendering.rig import Pose
from validation.rendering.shot import Rod, Shot
from validation.rendering.vectors import dot, segment_gaps

Array = NDArray[np.float64]

# A bead of which less than this part can be seen counts as hidden.
SEEN = 0.6


class Blockers:
    """What may stand between a camera and a point in one shot; `pose` is that of the body's frame in the camera's."""

    def __init__(self, shot: Shot, pose: Pose) -> None:
        self._pose = pose
        self._gripper = shot.gripper
        self._rods = [Rod(pose[0] @ r.start + pose[1], pose[0] @ r.end + pose[1], r.radius) for r in shot.rods]
        corners = (shot.points @ pose[0].T + pose[1])[shot.triangles]
        self._corners = corners[(corners[..., 2] > 0).all(axis=1)]
        rays = self._corners[..., :2] / self._corners[..., 2:]
        self._lower, self._upper = rays.min(axis=1), rays.max(axis=1)

    def hide(self, aims: Array, balls: Array, radius: float) -> NDArray[np.bool_]:
        """Which segments (n,) from the camera to `aims` (n, 3) meet something; `balls` (b, 3) are other beads."""
        hidden = self._body(aims) | self._box(aims)
        for rod in [*self._rods, *(Rod(ball, ball, radius) for ball in balls)]:
            hidden |= segment_gaps(aims, rod.start, rod.end) < rod.radius
        return np.asarray(hidden)

    def _body(self, aims: Array) -> NDArray[np.bool_]:
        rays = aims[:, :2] / aims[:, 2:]
        near = ((self._lower <= rays.max(axis=0)) & (self._upper >= rays.min(axis=0))).all(axis=1)
        a, b, c = np.moveaxis(self._corners[near], 1, 0)
        # A ray goes through a triangle if it is on the same side of the planes through the camera and the three edges.
        sides = np.stack([aims @ np.cross(p, q).T for p, q in ((b, c), (c, a), (a, b))])
        inside = (sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)
        total, volume = sides.sum(axis=0), dot(a, np.cross(b, c))
        # volume / total is how far along the segment the triangle is.
        before = (volume * total > 0) & (np.abs(volume) < np.abs(total))
        return np.asarray((inside & before).any(axis=1))

    def _box(self, aims: Array) -> NDArray[np.bool_]:
        box = self._gripper
        if box is None:
            return np.zeros(len(aims), dtype=bool)
        rotation, translation = self._pose
        eye = box.at_rest(-rotation.T @ translation)
        step = box.at_rest((aims - translation) @ rotation) - eye
        step = np.where(np.abs(step) < 1e-15, 1e-15, step)
        first, second = (box.lower - eye) / step, (box.upper - eye) / step
        enter, leave = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
        return np.asarray((enter <= leave) & (leave > 0) & (enter < 1))
