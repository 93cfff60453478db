"""Following an action: one equilibrium per step, with extrapolation along the motion and automatic sub-steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.forms.solver.equilibrium import Equilibrium
from bcid.forms.solver.status import WORDS, Status
from bcid.forms.solver.supports import Pose
from bcid.measurement import Action
from bcid.scene.rotation import slerp

Array = NDArray[np.float64]
# A guess may use this many states.
_MOST = 6
# A tangent is factorised, and its pivots looked at, at the latest after so many steps.
_TRUSTED = 8
# The trapezoidal rule may miss this part of the work of one step, and this part of the energy; above, the step is halved.
_OF_STEP, _OF_ENERGY = 0.1, 0.01


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
    """Accepted states by time (steps of the action): what the next one is interpolated or extrapolated from."""

    comm: Comm
    lever: float
    energy: EnergyCheck | None = None
    times: list[float] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    states: list[Array] = field(default_factory=list)

    def add(self, time: float, pose: Pose, state: Array) -> None:
        """Take a state as the newest."""
        self.times = [*self.times, time][-_MOST:]
        self.poses = [*self.poses, pose.vector(self.lever)][-_MOST:]
        self.states = [*self.states, state.copy()][-_MOST:]

    def guess(self, time: float, pose: Pose) -> Array | None:
        """State at `time` by a polynomial through the nearest states; collective.

        Of the orders that meet the pose (a motion that turns a corner is met badly through states from before it), the one
        from which the next lower differs least.
        """
        if not self.times:
            return None
        wanted = pose.vector(self.lever)
        nearest = sorted(range(len(self.times)), key=lambda i: (abs(self.times[i] - time), -i))
        guesses, misses = [], []
        for count in range(1, len(nearest) + 1):
            weights = _lagrange(np.array([self.times[i] for i in nearest[:count]]), time)
            guesses.append(sum(w * self.states[i] for w, i in zip(weights, nearest, strict=False)))
            miss = wanted - sum(w * self.poses[i] for w, i in zip(weights, nearest, strict=False))
            misses.append(float(np.linalg.norm(miss)))
        tolerance = min(misses) + 0.05 * misses[0]
        changes = self._norms(np.diff(guesses, axis=0, prepend=guesses[:1]))
        changes[0] = np.inf
        meeting = [m for m in range(len(guesses)) if misses[m] <= tolerance]
        return np.asarray(guesses[min(meeting, key=lambda m: (changes[m], m))])

    def _norms(self, states: Array) -> Array:
        squares = np.einsum("ij,ij->i", states, states)
        return np.sqrt(self.comm.allreduce(squares) if self.comm.size > 1 else squares)


def _lagrange(times: Array, at: float) -> Array:
    """Weights of the polynomial through values at `times`, evaluated `at`."""
    others = [np.delete(times, i) for i in range(len(times))]
    return np.array([np.prod((at - o) / (t - o)) for t, o in zip(times, others, strict=True)])


def poses(action: Action) -> list[Pose]:
    """The poses of an action, one per step."""
    times = action.clock
    return [
        Pose(
            action.translation[k],
            action.rotation[k],
            {place: load[k] for place, load in action.loads.items()},
            time=float(times[k]),
            boundary={place: moved[k] for place, moved in action.boundary.items()},
        )
        for k in range(len(action))
    ]


def _unloaded(action: Action) -> Pose:
    """Where an action comes from: nothing is loaded or driven."""
    loads = {place: np.zeros(3) for place in action.loads}
    still = {place: np.zeros_like(moved[0]) for place, moved in action.boundary.items()}
    return Pose(loads=loads, load_factor=0.0, time=float(action.clock[0]), boundary=still)


def follow(
    equilibrium: Equilibrium,
    action: Action,
    seen: Callable[[int, Pose], bool | None],
    known: Mapping[int, Array] | None = None,
) -> Trajectory:
    """Move the gripper along an action from the undeformed state; collective on the body's communicator.

    The tangent is factorised every few steps and at the end, if the settings ask for its pivots; one that `seen` has factorised
    serves as well. When it turns out not to be positive definite, the motion goes back to the last state that was seen to be
    stable (to rest, where the model remembers what came before) and is repeated with a tangent of its own for every iteration.

    Args:
        equilibrium: holds the anchors already; its grasp must be the action's.
        action: the motion.
        seen: called after each step with its number and pose, to read the state; the motion ends early when it returns
            False. Where the motion went back it is called again for the same steps: the later call holds.
        known: states (this rank's unknowns) that are nearly right, by step: where to start from.

    Returns:
        How far it came. A step that fails is halved, up to `settings.halvings` times; what cannot be mended ends the
        trajectory with a named status, and the last good state is kept.
    """
    equilibrium.reset()
    result = Trajectory()
    start = equilibrium.iterations, equilibrium.factor.count
    path = [
        _unloaded(action),
        *poses(action),
    ]
    history = _History(equilibrium.body.comm, equilibrium.supports.lever, EnergyCheck.at_rest(equilibrium))
    safe = 0, replace(history)
    done, stopped = 0, False
    while done < len(action) and not stopped:
        status = Status.DIVERGED
        if known and done in known:
            status = _find(equilibrium, path[done + 1], done, history, known[done])
        if status is not Status.CONVERGED:
            status = _advance(equilibrium, path[done], path[done + 1], done, history, result)
        ended = status is not Status.CONVERGED and _at_its_end(equilibrium, history)
        if status is Status.CONVERGED:
            stopped = seen(done, path[done + 1]) is False
            equilibrium.accept(path[done + 1])
            done += 1
            asked = equilibrium.settings.pivots and (equilibrium.age >= _TRUSTED or done == len(action))
            if not stopped and (asked or equilibrium.verified):
                status = equilibrium.confirm()
                if status is Status.CONVERGED and not equilibrium.model.remembers:
                    safe = done, replace(history)
        if status is not Status.CONVERGED:
            if equilibrium.careful or ended:
                result.status, result.reason = (
                    status,
                    f"{WORDS[status]}; action {action.name} ended {_where(action, done)}",
                )
                break
            done, history = safe[0], replace(safe[1])
            if not done:
                equilibrium.reset()
            equilibrium.start_over(history.states[-1] if history.states else None)
    result.steps = done
    result.iterations, result.factorisations = equilibrium.iterations - start[0], equilibrium.factor.count - start[1]
    return result


def _at_its_end(eq: Equilibrium, history: _History) -> bool:
    """Whether the last good state is stable, so that to come there again would lead to no other end.

    What fails with an old tangent was tried from the same state with one of its own for every iteration.
    """
    return eq.model.reversible and bool(history.times) and eq.verify() is Status.CONVERGED


def _where(action: Action, done: int) -> str:
    return "after its last step" if done == len(action) else f"at step {action.steps[done]} of {action.steps[-1]}"


def _advance(eq: Equilibrium, last: Pose, pose: Pose, step: int, history: _History, result: Trajectory) -> Status:
    """One step of the motion, cut into sub-steps where it fails."""
    if (
        not eq.model.terms
        and not pose.loads
        and np.allclose(pose.vector(1.0), last.vector(1.0), atol=1e-15)
        and not history.times
    ):
        history.add(step, pose, eq.u.x.array)
        return Status.CONVERGED
    done, size, halved = 0.0, 1.0, 0
    while done < 1.0:
        part = min(done + size, 1.0)
        target, time = between(last, pose, part), step - 1 + part
        status = _find(eq, target, time, history, history.guess(time, target))
        if status is not Status.CONVERGED and len(history.times) > 1:
            # The extrapolation may be what failed: start once more from the last state itself.
            status = _find(eq, target, time, history)
        if status is Status.CONVERGED:
            done = part
            if 0 < part < 1 and step > 0:
                eq.accept(target)
        elif halved == eq.settings.halvings:
            return status
        else:
            size, halved = size / 2, halved + 1
            result.halvings += 1
    return Status.CONVERGED


def _find(eq: Equilibrium, pose: Pose, time: float, history: _History, start: Array | None = None) -> Status:
    """The equilibrium at a pose, added to the history, if the motion can lead there from the last one."""
    before = eq.u.x.array.copy()
    status = eq.solve(pose, start)
    if status is Status.CONVERGED and eq.model.conservative:
        energy = EnergyCheck.of(eq, pose)
        if history.energy is not None and not energy.follows(history.energy, eq):
            eq.start_over(before)
            return Status.JUMPED
        history.energy = energy
    if status is Status.CONVERGED:
        history.add(time, pose, eq.u.x.array)
    return status


def between(a: Pose, b: Pose, fraction: float) -> Pose:
    """Pose between two: straight for translation, loads and driven places, along the shortest arc for the rotation (slerp)."""
    if fraction == 1.0:
        return b
    loads = {place: (1 - fraction) * a.loads[place] + fraction * b.loads[place] for place in b.loads}
    boundary = {place: (1 - fraction) * a.boundary[place] + fraction * b.boundary[place] for place in b.boundary}
    translation = (1 - fraction) * a.translation + fraction * b.translation
    load_factor, time = (
        (1 - fraction) * a.load_factor + fraction * b.load_factor,
        (1 - fraction) * a.time + fraction * b.time,
    )
    return Pose(translation, slerp(a.rotation, b.rotation, fraction), loads, load_factor, time, boundary)


@dataclass(frozen=True)
class EnergyCheck:
    """Energy of an equilibrium, and the forces from outside that keep it there.

    A large step can end in a state that is stable, and not the one that the motion leads to. What the two differ in is
    energy: of what a body gains between two equilibria, a gripper that moves slowly has provided every part. Its work is
    told by the trapezoidal rule from the forces at both ends. A state of less energy is not suspicious: a body that
    buckles, or snaps through, loses some.

    Attributes:
        energy: strain energy and potential of the effects, J; the same on all ranks.
        forces: of gripper, anchors and dead loads on this rank's own unknowns, N, see `Equilibrium.applied`.
        moved: how far what they act on has moved, m.
        load_factor: fraction of the effects that acted.
    """

    energy: float
    forces: Array
    moved: Array
    load_factor: float

    @classmethod
    def of(cls, equilibrium: Equilibrium, pose: Pose) -> EnergyCheck:
        """Of a state that was just solved for; collective."""
        return cls(equilibrium.energy(), *equilibrium.applied(), pose.load_factor)

    @classmethod
    def at_rest(cls, equilibrium: Equilibrium) -> EnergyCheck | None:
        """Of the undeformed state; None where effects are to be applied first."""
        none = np.zeros(2 * len(equilibrium.internal))
        return None if equilibrium.model.terms else cls(0.0, none, none, 1.0)

    def follows(self, last: EnergyCheck, equilibrium: Equilibrium) -> bool:
        """Whether the gripper can have led from the last state to this one; collective."""
        if self.load_factor != last.load_factor:
            return True
        work = equilibrium.total(0.5 * float((self.forces + last.forces) @ (self.moved - last.moved)))
        gained = self.energy - last.energy
        unsure = _OF_STEP * max(abs(gained), abs(work)) + _OF_ENERGY * max(abs(self.energy), abs(last.energy))
        return gained - work <= unsure + equilibrium.least_energy
