"""What an anchor set predicts for one pull: where the fiducials go, and whether force, strain and stability allow it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.forms.forward import Forward
from bcid.forms.solver.buckling import NEAR_BUCKLING, linear_buckling, smallest_eigenvalue, two_states
from bcid.forms.solver.supports import Pose
from bcid.forms.solver.trajectory import poses
from bcid.measurement import Action

Array = NDArray[np.float64]
Anchored = frozenset[str]
# The strain that so much of the volume stays below: in corners it has no limit.
_VOLUME = 0.99
# On a path along which the body does not become softer than this part there is nothing to buckle.
_STIFF = 0.95


@dataclass(frozen=True)
class PullPrediction:
    """What an anchor set predicts for an action.

    Attributes:
        positions: shape (frames, rows, 3), m, as in a `Prediction`; NaN where it cannot be predicted.
        force: largest force of the gripper, N; NaN if it was not asked for, like all that follows.
        strain: largest principal strain that 99 % of the volume stays below, over all frames.
        eigenvalue: smallest eigenvalue of the tangent as part of that at rest, over all frames: below 0.5 the body may buckle;
            zero where it has buckled: two states exist at the far end.
        loose: how positions change when one of the numbers that are not known, or a combination of them, changes by its standard
            deviation, each of the shape of `positions`, m.
    """

    positions: Array
    force: float = math.nan
    strain: float = math.nan
    eigenvalue: float = math.nan
    loose: tuple[Array, ...] = ()

    @cached_property
    def failed(self) -> bool:
        """Whether it cannot be predicted."""
        return not bool(np.isfinite(self.positions).all())

    @property
    def detailed(self) -> bool:
        """Whether force, strain and eigenvalue are known."""
        return self.failed or math.isfinite(self.eigenvalue)

    @property
    def buckles(self) -> bool:
        """Whether the body may buckle, so that imperfections decide where it goes."""
        return self.failed or self.eigenvalue < NEAR_BUCKLING


def predicted(forward: Forward, anchors: Anchored, action: Action, detailed: bool) -> PullPrediction:
    """Predict an action of an anchor set on this process.

    A way back that repeats the way there is not computed, unless an effect depends on time, or remembers.
    """
    first = there(action, forward.model.steady)
    details = _Details(forward, first) if detailed else None
    prediction = forward.predict(anchors, [first], keep=detailed, look=details)
    result = PullPrediction(prediction.positions[back(action, forward.model.steady)])
    if details is None or prediction.failure or prediction.states is None:
        return result
    return details.added(result, anchors, [prediction.states[int(frame)] for frame in first.frames])


class _Details:
    """Force, strain and smallest eigenvalue of each frame, read while the body is followed.

    The tangent that is factorised for the eigenvalue shows that the state is stable, and serves the next step besides.
    """

    def __init__(self, forward: Forward, action: Action) -> None:
        self.forward, self.action = forward, action
        self._read: dict[int, tuple[float, float, float]] = {}
        self._mode: Array | None = None

    def __call__(self, frame: int, pose: Pose) -> None:
        """Read the present state; one that comes again holds."""
        equilibrium = self.forward.equilibrium
        size, self._mode = smallest_eigenvalue(equilibrium, self._mode)
        force = float(np.linalg.norm(equilibrium.wrench(pose)[:3]))
        self._read[frame] = force, strain_of_most(self.forward, equilibrium.displacement()), size

    def added(self, result: PullPrediction, anchors: Anchored, states: Sequence[Array]) -> PullPrediction:
        """A prediction with what was read; `states` are those of the frames."""
        forces, strains, sizes = zip(*(self._read[frame] for frame in sorted(self._read)), strict=True)
        eigenvalue = min(sizes) / sizes[0]
        if NEAR_BUCKLING <= eigenvalue < _STIFF and _has_buckled(self.forward, anchors, self.action, states):
            eigenvalue = 0.0
        return replace(result, force=max(forces), strain=max(strains), eigenvalue=eigenvalue)


def _has_buckled(forward: Forward, anchors: Anchored, action: Action, states: Sequence[Array]) -> bool:
    """Whether two states exist where the gripper is furthest from rest."""
    model, equilibrium = forward.model, forward.equilibrium
    if not model.reversible:
        return False
    equilibrium.hold(anchors, action.grasp)
    path = poses(model.driven(action))
    far = int(np.argmax(np.linalg.norm(action.translation, axis=1)))
    mode = linear_buckling(equilibrium, states[0], path[0], path[far])
    if mode.part > 1 / NEAR_BUCKLING:
        return False
    return two_states(equilibrium, forward.fiducials, mode, states[0], path[far], states[far])


def strain_of_most(forward: Forward, displacement: Array) -> float:
    """Largest |principal stretch - 1| that 99 % of the volume stays below, from the corners of the cells; collective."""
    mesh = forward.mesh
    moved = mesh.points + forward.body.at_mesh_nodes(displacement)
    rest, now = (p[mesh.cells[:, 1:]] - p[mesh.cells[:, :1]] for p in (mesh.points, moved))
    stretches = np.linalg.svd(np.swapaxes(now, 1, 2) @ np.linalg.inv(np.swapaxes(rest, 1, 2)), compute_uv=False)
    strain = np.abs(stretches - 1).max(axis=1)
    volume = np.abs(np.linalg.det(rest))
    order = np.argsort(strain)
    below = np.cumsum(volume[order]) / volume.sum()
    return float(strain[order][min(int(np.searchsorted(below, _VOLUME)), len(strain) - 1)])


def there(action: Action, steady: bool) -> Action:
    """The motion up to where it turns and goes the same way back, frames numbered from 0; all of it where it does not.

    Nor where the body is not `steady`: its state depends on time, or on what was before.
    """
    count = _turning(action) if steady else len(action)
    return replace(action.until(count), frames=np.arange(count), times=action.clock[:count])


def back(action: Action, steady: bool) -> NDArray[np.int64]:
    """For each frame of a motion, that of the way there in which the body is the same; shape (frames,)."""
    frames = np.arange(len(action))
    return np.minimum(frames, frames[::-1]) if len(there(action, steady)) < len(action) else frames


def _turning(action: Action) -> int:
    """Number of steps to where the motion turns and goes the same way back; all steps where it does not."""
    same = np.allclose(action.translation, action.translation[::-1], atol=1e-9) and np.allclose(
        action.rotation, action.rotation[::-1], atol=1e-9
    )
    loaded = any(not np.allclose(load, load[::-1]) for load in action.loads.values())
    return len(action) // 2 + 1 if same and not loaded and len(action) % 2 else len(action)
