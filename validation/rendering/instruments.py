"""Instruments that move between the cameras and a body, and hide a wanted share of its beads."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.vision.camera import Cameras
from validation.rendering.blockers import SEEN
from validation.rendering.rig import Pose, between, both_poses
from validation.rendering.shot import Rod
from validation.rendering.vectors import segment_gaps, unit

Array = NDArray[np.float64]

# Thickness of instruments and height above the beads, both relative to the distance of the cameras.
_SLENDER, _HEIGHT = (0.003, 0.012), (0.2, 0.35)
_TRIALS = 60


def instruments(
    share: float, beads: Array, cameras: Cameras, pose: Pose, random_state: int = 0, diameter: float = 1e-3
) -> list[list[Rod]]:
    """Slender rods that move smoothly between the cameras and the body and hide a share of the beads.

    Where the rods move is random; their thickness is then chosen such that the wanted share of all (frame, bead) is hidden
    from at least one camera.

    Args:
        share: wanted, 0 to 0.8.
        beads: centres of the beads in every frame, shape (frames, k, 3), body frame, m.
        cameras, pose: as for `Renderer`.
        random_state: seed.
        diameter: of the beads, m.

    Returns:
        For every frame its rods.

    Raises:
        InputError: bad values, or no rods were found that hide this share (a few frames with few beads allow few shares).
    """
    beads = np.asarray(beads, dtype=float)
    if beads.ndim != 3 or beads.shape[2] != 3 or beads.size == 0 or not np.isfinite(beads).all():
        raise InputError(f"beads: expected finite numbers of shape (frames, beads, 3), found shape {beads.shape}")
    if not 0 <= share <= 0.8:
        raise InputError(f"share of hidden beads: must be from 0 to 0.8, is {share}")
    if share == 0:
        return [[] for _ in beads]
    poses = both_poses(cameras, pose)
    random = np.random.default_rng(random_state)
    distance = float(np.linalg.norm(between(poses) - beads.mean(axis=(0, 1))))
    for trial in range(_TRIALS):
        tips, ends = _paths(1 + trial // 5, beads, poses, random)
        limits = np.min([_limits(beads, tips, ends, at, diameter / 2) for at in poses], axis=0)
        radius = float(np.quantile(limits, share))
        fits = _SLENDER[0] * distance <= radius <= _SLENDER[1] * distance
        if fits and abs(np.mean(limits < radius) - share) < 0.03:
            return [[Rod(a, b, radius) for a, b in zip(*frame, strict=True)] for frame in zip(tips, ends, strict=True)]
    raise InputError(f"no slender instruments found that hide {share:.0%} of the beads; ask for another share or seed")


def _paths(count: int, beads: Array, poses: list[Pose], random: np.random.Generator) -> tuple[Array, Array]:
    """Tips and far ends (frames, count, 3) of rods that come in from outside of the pictures."""
    centre, eye = beads.mean(axis=(0, 1)), between(poses)
    distance, above = float(np.linalg.norm(eye - centre)), unit(eye - centre)
    right = unit(np.cross(np.cross(above, poses[0][0][0]), above))
    back = np.cross(above, right)
    reach = float(np.sqrt(np.mean(np.sum((beads - centre) ** 2, axis=-1))))
    time = np.linspace(0, 1, len(beads))[:, None]
    tips, ends = [], []
    for _ in range(count):
        turn, *phase = random.uniform(0, 2 * math.pi, 3)
        cycles = random.uniform(0.5, 2, 2)
        inward = -(math.cos(turn) * right + math.sin(turn) * back)
        sweep = reach * np.sin(2 * math.pi * (cycles * time + phase))
        start = centre + random.uniform(*_HEIGHT) * distance * above + reach * random.uniform(-0.5, 0.5) * inward
        tip = start + 0.8 * sweep[:, :1] * inward + 0.6 * sweep[:, 1:] * np.cross(above, inward)
        tips.append(tip)
        ends.append(tip + 1.5 * distance * (0.3 * above - inward))
    return np.stack(tips, axis=1), np.stack(ends, axis=1)


def _limits(beads: Array, tips: Array, ends: Array, pose: Pose, radius: float) -> Array:
    """Radius (frames, k) of the rods above which a bead counts as hidden from the camera with this pose."""
    rotation, translation = pose
    beads, tips, ends = (v @ rotation.T + translation for v in (beads, tips, ends))
    across = np.stack([np.cross(beads, [0, 1.0, 0]), np.cross(beads, [1.0, 0, 0])], axis=-2)
    disc = radius * _sunflower(24) @ unit(across)
    aims = (beads * (1 - radius / np.linalg.norm(beads, axis=-1, keepdims=True)))[:, :, None] + disc
    gaps = [
        segment_gaps(aims.reshape(len(beads), -1, 3), tips[:, i, None], ends[:, i, None]).reshape(aims.shape[:-1])
        for i in range(tips.shape[1])
    ]
    return np.asarray(np.quantile(np.min(gaps, axis=0), 1 - SEEN, axis=-1))


def _sunflower(count: int) -> Array:
    """Points (count, 2) that cover the unit disc evenly."""
    number = np.arange(count)
    angle = number * math.pi * (3 - math.sqrt(5))
    return np.asarray(np.sqrt((number + 0.5) / count)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
