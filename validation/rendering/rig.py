"""Two cameras around a body: where they stand and what they look at. A pose takes the body's frame to a camera's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.vision.camera import Camera, Cameras
from validation.rendering.vectors import unit

Array = NDArray[np.float64]
# Rotation (3, 3) and translation (3,), m: a point x of the body's frame is at rotation x + translation in the camera's.
Pose = tuple[Array, Array]


def looking_at(target: Array, eye: Array, up: Array) -> Pose:
    """Pose (rotation (3, 3), translation (3,) m) of the body frame in a camera's frame.

    The camera is at `eye` (3,), its axis z goes through `target` (3,), both in the body frame, m; `up` (3,) points upwards in
    its image.

    Raises:
        InputError: the camera is at its target or looks along `up`.
    """
    target, eye, up = (_three(v, name) for v, name in ((target, "target"), (eye, "eye"), (up, "up")))
    ahead = target - eye
    right = np.cross(ahead, up)
    if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(ahead) * np.linalg.norm(up) > 0:
        raise InputError(f"a camera at {eye} cannot look at {target} with {up} upwards: the three are on one line")
    rotation = np.array([unit(right), unit(np.cross(ahead, right)), unit(ahead)])
    return rotation, -rotation @ eye


def stereo_rig(
    target: Sequence[float] | Array = (0.061, 0.005, 0.05),
    direction: Sequence[float] | Array = (-0.42, 0.91, 0.0),
    up: Sequence[float] | Array = (0.0, 1.0, 0.0),
    distance: float = 0.30,
    angle: float = 30.0,
    size: tuple[int, int] = (1280, 1024),
    field: float = 0.175,
    distortion: Sequence[float] | Array = (-0.08, 0.05, 3e-4, -2e-4, 0.0),
) -> tuple[Cameras, Pose]:
    """Two converging cameras as in the benchmark experiment, and the pose of the body frame in the left one.

    With the defaults they look at the slab of the examples from above, a little from the side away from the gripper; the
    slab and 30 mm of motion are in view. The two differ a little, as real ones do.

    Args:
        target: what both look at, body frame, m.
        direction: from the target to the middle between the cameras.
        up: what is upwards in the images.
        distance: of each camera from the target, m.
        angle: between their axes, deg.
        size: width and height of the images, px.
        field: width of what is in view at the target, m.
        distortion: coefficients of the lenses.

    Raises:
        InputError: bad values.
    """
    if not (distance > 0 and field > 0 and 0 < angle < 180 and min(size) > 0):
        raise InputError("stereo rig: distance, field, size and angle must be positive, the angle below 180 deg")
    target, direction, up = (_three(v, "target, direction and up") for v in (target, direction, up))
    aside = unit(np.cross(-direction, up))
    # Both are rolled such that the line between them is level in both images.
    upright = np.asarray(np.cross(direction, aside), dtype=float)
    half = math.radians(angle) / 2
    poses, cameras = [], []
    for side, sign in enumerate((-1, 1)):
        eye = target + distance * (math.cos(half) * unit(direction) + sign * math.sin(half) * aside)
        poses.append(looking_at(target, eye, upright))
        focal = size[0] * distance / field * (1, 1.004)[side]
        middle = (np.array(size) - 1) / 2 + np.array([[0.005, -0.004], [-0.004, 0.006]])[side] * size[0]
        matrix = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1.0]])
        cameras.append(Camera(matrix, np.asarray(distortion, dtype=float), (int(size[0]), int(size[1]))))
    (left, start), (right, end) = poses
    rotation = right @ left.T
    return Cameras(cameras[0], cameras[1], rotation, end - rotation @ start), (left, start)


def both_poses(cameras: Cameras, pose: Pose) -> list[Pose]:
    """Poses of the body's frame in both cameras, from that in the left one.

    Raises:
        InputError: the pose is none.
    """
    rotation, translation = (np.asarray(value, dtype=float) for value in pose)
    turns = rotation.shape == (3, 3) and np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-6
    if not turns or np.linalg.det(rotation) < 0:
        raise InputError("pose of the body: its rotation is not a 3 x 3 rotation matrix")
    translation = _three(translation, "translation of the body")
    return [
        (rotation, translation),
        (cameras.rotation @ rotation, cameras.rotation @ translation + cameras.translation),
    ]


def between(poses: list[Pose]) -> Array:
    """The middle between the cameras, shape (3,), body frame, m."""
    return np.asarray(np.mean([-rotation.T @ translation for rotation, translation in poses], axis=0))


def _three(value: Any, name: str) -> Array:
    vector = np.asarray(value, dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{name}: expected three finite coordinates, found {value!r}")
    return vector
