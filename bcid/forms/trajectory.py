"""Following an action: one equilibrium per step, with extrapolation along the motion and automatic sub-steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bcid.forms.solve import WORDS, Equilibrium, Pose, Status
from bcid.measurement import Action

Array = NDArray[np.float64]
_EXTRAPOLATIONS = ((3.0, -3.0, 1.0), (2.0, -1.0), (1.0,))


@dataclass
class Trajectory:
    """Outcome of following an action.

    Attributes:
        status: `CONVERGED`, or why it ended early.
        steps: number of steps reached (the rest step included).
        halvings: how often a step was halved.
        iterations, factorisations: work done.
        reason: the status in words; where it ended.
    """

    status: Status = Status.CONVERGED
    steps: int = 0
    halvings: int = 0
    iterations: int = 0
    factorisations: int = 0
    reason: str = ""


@dataclass
class _History:
    """The last accepted states, newest first: what the next one is extrapolated from."""

    poses: list[Array] = field(default_factory=list)
    states: list[Array] = field(default_factory=list)

    def add(self, pose: Pose, state: Array) -> None:
        self.poses = [pose.vector(), *self.poses][:3]
        self.states = [state.copy(), *self.states][:3]

    def guess(self, pose: Pose) -> Array | None:
        """State at `pose` by the extrapolation that meets the pose best; the higher order when several do."""
        wanted = pose.vector()
        usable = [c for c in _EXTRAPOLATIONS if len(c) <= len(self.poses)]
        if not usable:
            return None
        misses = [np.linalg.norm(sum(c * p for c, p in zip(cs, self.poses, strict=False)) - wanted) for cs in usable]
        tolerance = min(misses) + 0.05 * float(np.linalg.norm(wanted - self.poses[0]))
        best = next(cs for cs, miss in zip(usable, misses, strict=True) if miss <= tolerance)
        return np.asarray(sum(c * s for c, s in zip(best, self.states, strict=False)))


def poses(action: Action) -> list[Pose]:
    """The poses of an action, one per step."""
    return [
        Pose(action.translation[k], action.rotation[k], {place: load[k] for place, load in action.loads.items()})
        for k in range(len(action))
    ]


def follow(equilibrium: Equilibrium, action: Action, seen: Callable[[int, Pose], bool | None]) -> Trajectory:
    """Move the gripper along an action from the undeformed state; collective on the body's communicator.

    Args:
        equilibrium: holds the anchors already; its grasp must be the action's.
        action: the motion.
        seen: called after each step with its number and pose, to read the state; the motion ends early when it returns
            False.

    Returns:
        How far it came. A step that fails is halved, up to `settings.halvings` times; what cannot be mended ends the
        trajectory with a named status, and the last good state is kept.
    """
    equilibrium.reset()
    result = Trajectory()
    start = equilibrium.iterations, equilibrium.factor.count
    history = _History()
    last = Pose(loads={place: np.zeros(3) for place in action.loads}, dose=0.0)
    stopped = False
    for k, pose in enumerate(poses(action)):
        status = _advance(equilibrium, last, pose, history, result)
        if status is not Status.CONVERGED:
            result.status = status
            result.reason = (
                f"{WORDS[status]}; action {action.name} ended at step {action.steps[k]} of {action.steps[-1]}"
            )
            break
        last = pose
        result.steps = k + 1
        if seen(k, pose) is False:
            stopped = True
            break
    if result.status is Status.CONVERGED and not stopped:
        result.status = equilibrium.verify()
        if result.status is not Status.CONVERGED:
            result.reason = f"{WORDS[result.status]} at the end of action {action.name}"
    result.iterations, result.factorisations = equilibrium.iterations - start[0], equilibrium.factor.count - start[1]
    return result


def _advance(eq: Equilibrium, last: Pose, pose: Pose, history: _History, result: Trajectory) -> Status:
    """One step of the motion, cut into sub-steps where it fails."""
    if (
        not eq.model.doses
        and not pose.loads
        and np.allclose(pose.vector(), last.vector(), atol=1e-15)
        and not history.poses
    ):
        history.add(pose, eq.u.x.array)
        return Status.CONVERGED
    done, size, halved = 0.0, 1.0, 0
    while done < 1.0:
        target = between(last, pose, min(done + size, 1.0))
        status = eq.solve(target, history.guess(target))
        if status is not Status.CONVERGED and len(history.poses) > 1:
            # The extrapolation may be what failed: start once more from the last state itself.
            status = eq.solve(target)
        if status is Status.CONVERGED:
            done += size
            history.add(target, eq.u.x.array)
        elif halved == eq.settings.halvings:
            return status
        else:
            size, halved = size / 2, halved + 1
            result.halvings += 1
    return Status.CONVERGED


def between(a: Pose, b: Pose, fraction: float) -> Pose:
    """Pose between two: straight for translation and loads, along the shortest arc for the rotation (slerp)."""
    if fraction == 1.0:
        return b
    loads = {place: (1 - fraction) * a.loads[place] + fraction * b.loads[place] for place in b.loads}
    translation = (1 - fraction) * a.translation + fraction * b.translation
    return Pose(
        translation, _slerp(a.rotation, b.rotation, fraction), loads, (1 - fraction) * a.dose + fraction * b.dose
    )


def _slerp(a: Array, b: Array, fraction: float) -> Array:
    cosine = float(a @ b)
    if cosine < 0:
        b, cosine = -b, -cosine
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-9:
        mixed = (1 - fraction) * a + fraction * b
    else:
        mixed = (np.sin((1 - fraction) * angle) * a + np.sin(fraction * angle) * b) / np.sin(angle)
    return np.asarray(mixed / np.linalg.norm(mixed))
