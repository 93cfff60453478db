"""Misfit in observation space: what a model of the body may miss that no force of its family makes.

A gripper that is not rigid, a far field, another body: such a model is wrong in a few independent numbers, not in as many as
there are frames and markers. The misfit is a Gaussian process over markers and poses of the gripper (Kennedy & O'Hagan,
J. R. Stat. Soc. B 63 (2001) 425), the same for all hypotheses:

    cov(eta_i, eta_j) = kappa^2 exp(-|x_i - x_j|^2 / 2 l^2) (p_i . p_j + A exp(-|p_i - p_j|^2 / 2 L^2))

for the same axis of markers at x_i, x_j with the gripper at p_i, p_j; actions with the same poses share it. Forces and torques
of the gripper have a block each. It is kept in at most
`Priors.misfit_columns` columns; the variance that these leave out makes the noise larger.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bcid.inference.data import Data
from bcid.inference.evidence import LowRankDiscrepancy
from bcid.inference.priors import PRIORS
from bcid.scene import Scene
from bcid.scene.rotation import as_rotation

Array = NDArray[np.float64]


@lru_cache(maxsize=2)
def columns(data: Data) -> list[Array]:
    """What a misfit of size one does to the values, for each length: (n, k), m; k at most `misfit_columns` for positions."""
    frames = np.unique(data.frame)
    pose = _over_poses(poses(data)[frames])
    row = np.searchsorted(frames, data.frame)
    found = []
    for length in PRIORS.misfit_lengths:
        blocks = [_block(data, kind, row, pose, length) for kind in np.unique(data.kind)]
        found.append(np.hstack(blocks))
    return found


def processes(data: Data, sigma: Array, whiten: Callable[[Array], Array]) -> list[LowRankDiscrepancy]:
    """The process of each length, in units of errors.

    Args:
        data: the values.
        sigma: standard deviation of their noise, shape (n,), m.
        whiten: brings columns (n, k), m, into units of all their errors.
    """
    variance = _variance(data)
    found = []
    for each in columns(data):
        left_out = float(np.mean((variance - np.sum(each**2, axis=1)) / sigma**2))
        found.append(LowRankDiscrepancy.of(whiten(each), scales(data, sigma), max(left_out, 0.0)))
    return found


def _variance(data: Data) -> Array:
    """Of a process of size one, of each value, shape (n,)."""
    return np.asarray(np.sum(poses(data) ** 2, axis=1)[data.frame] + PRIORS.misfit_smooth[0])


def scales(data: Data, sigma: Array) -> Array:
    """Standard deviations of the misfit that are equally likely, m: from the noise to the motion, shape (sizes,)."""
    noise, motion = data.rms(sigma), data.rms(data.values - data.vector(np.broadcast_to(data.rest, data.mask.shape)))
    return np.geomspace(noise, max(motion, 2 * noise), PRIORS.misfit_sizes, dtype=float)


def poses(data: Data) -> Array:
    """Pose of the gripper, known loads, and driven places in every frame: shape (frames, k), the furthest at a distance of one.

    Each grasp and each loaded or driven place has coordinates of its own; a turn counts by how far it moves the nearest marker.
    """
    count, scene = len(data.mask), data.scene
    moved, loaded = np.zeros((count, 6 * len(scene.grasps))), dict[str, Array]()
    driven: dict[str, Array] = {}
    for action in data.measurement.actions:
        if action.grasp:
            at = 6 * list(scene.grasps).index(action.grasp)
            turn = (as_rotation(action.rotation) * as_rotation(action.rotation[0]).inv()).as_rotvec()
            moved[action.frames, at : at + 3] = action.translation
            moved[action.frames, at + 3 : at + 6] = turn * _arm(scene, action.grasp)
        for place, force in action.loads.items():
            loaded.setdefault(place, np.zeros((count, 3)))[action.frames] = force
        for place, points in action.boundary.items():
            driven.setdefault(place, np.zeros((count, points[0].size)))[action.frames] = points.reshape(len(points), -1)
    parts = (moved, _joined(loaded.values(), count), _joined(driven.values(), count))
    return _joined(map(_scaled, parts), count)


def _arm(scene: Scene, grasp: str) -> float:
    """Distance of the nearest marker from a grasp, m."""
    return float(np.linalg.norm(scene.rest - np.array(scene.grasps[grasp].centre), axis=1).min())


def _joined(parts: Iterable[Array], count: int) -> Array:
    return np.hstack([np.zeros((count, 0)), *parts])


def _scaled(part: Array) -> Array:
    """Coordinates with the furthest at a distance of one; none where nothing moves."""
    furthest = float(np.linalg.norm(part, axis=1).max(initial=0.0))
    return np.asarray(part / furthest) if furthest > 0 else part[:, :0]


def _over_poses(pose: Array) -> Array:
    """Covariance over the poses of frames, shape (frames, frames)."""
    variance, length = PRIORS.misfit_smooth
    return np.asarray(pose @ pose.T + variance * _near(pose, length))


def _near(points: Array, length: float) -> Array:
    squares = np.sum(points**2, axis=1)
    apart = np.maximum(squares[:, None] + squares - 2 * points @ points.T, 0.0)
    return np.asarray(np.exp(-0.5 * apart / length**2))


def _block(data: Data, kind: int, row: NDArray[np.int64], pose: Array, length: float) -> Array:
    """Columns of positions, of forces, or of torques: zero in the rows of the others."""
    inside = data.kind == kind
    names = np.unique(data.fiducial[inside])
    places = data.rest[names]
    size = max(float(np.linalg.norm(np.ptp(places, axis=0))), 1e-12)
    over_markers, over_poses = _factors(_near(places, length * size)), _factors(pose)
    # The largest products of eigenvalues: a Kronecker product has those of its factors.
    strength = np.einsum("p,m->pm", np.sum(over_poses**2, axis=0), np.sum(over_markers**2, axis=0))
    kept = np.argsort(-strength, axis=None, kind="stable")[: PRIORS.misfit_columns // 3]
    of_pose, of_marker = np.unravel_index(kept[strength.ravel()[kept] > 1e-9 * strength.max()], strength.shape)
    marker = np.searchsorted(names, data.fiducial[inside])
    values = over_poses[row[inside]][:, of_pose] * over_markers[marker][:, of_marker]
    found = np.zeros((len(data), 3 * values.shape[1]))
    # Each axis by itself; of a surface mark the normal has a part of each.
    directions = data.seen.directions[inside]
    found[inside] = (directions[:, :, None] * values[:, None, :]).reshape(len(values), -1)
    return found


def _factors(covariance: Array) -> Array:
    """Columns F with F F' = covariance, the largest first."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-9 * values[-1]
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))[:, ::-1]
