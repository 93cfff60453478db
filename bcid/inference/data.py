"""The measured coordinates as one vector, with what is known of their noise."""

from __future__ import annotations

import math
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.tails import normal_tail
from bcid.forms.gripper_force import ROWS, ForceScale
from bcid.inference.priors import PRIORS
from bcid.inference.seen import Seen, normals_of
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Action, Measurement
from bcid.scene import Scene
from bcid.scene.rotation import as_rotation

Array = NDArray[np.float64]
# Without a stated noise and with too few steps to see it, m.
LEAST_NOISE = 1e-6
# Standard deviation of Gaussian values per median of their sizes.
_PER_MEDIAN = 1.4826
# Standard deviation of Gaussian values per median of their sizes, and of their third differences per that of one.
_PER_MEDIAN, _THIRD = 1.4826, math.sqrt(20)


@dataclass(frozen=True)
class Noise:
    """What a residual says of the noise.

    Attributes:
        sigma: standard deviation that it has, m.
        factor: how many times the stated one that is; 1 where none is stated.
        error: standard error of the logarithm of both.
        axes: the factor of each axis, where what is stated of one differs from the others; the rest is then of that which surprises
            most.
    """

    sigma: float
    factor: float
    error: float
    axes: tuple[float, float, float] | None = None

    @property
    def surprising(self) -> bool:
        """Whether chance lets expect no such difference from what is stated."""
        return bool(2 * normal_tail(self.deviation) < THRESHOLDS.surprise)

    @property
    def deviation(self) -> float:
        """How many standard errors it differs from what is stated."""
        return abs(math.log(self.factor)) / self.error


class Data:
    """Every visible coordinate of a measurement, in one vector, with the labels needed to group them.

    Force and torque of the gripper, where they were measured, are two rows more beside the fiducials, see
    `bcid.forms.gripper_force`.

    Args:
        scene: the scene.
        measurement: must fit the scene.
        forces: what force and torque are divided by; None where they do not count.

    Attributes:
        mask: which of (frames, rows, 3) were seen; of a surface mark the first stands for the component along the normal.
        names: of the rows.
        rest: what they show at rest, shape (rows, 3), m.
        about: measured values (frames, rows, 3), m, and those at rest where nothing was seen.
        values: measured positions, shape (n,), m; of surface marks along the normal of the surface.
        sigma: standard deviation of each, m; NaN where it is not known.
        slow: standard deviation of what errors of each have besides that persists along its trajectory, m: what of a stated one is
            not like noise.
        stated: whether that is what measurement or scene say of positions, and not an estimate.
        action, grasp, frame, step, fiducial, axis: labels, shape (n,); actions and fiducials (or rows) as numbers.
        kind: of each value, shape (n,): 0 a position, 1 a force, 2 a torque.
        trajectory: number of the (action, fiducial, axis) it belongs to, shape (n,).
        progress: part of its action that is done, 0 at step 0 and 1 at the last step seen, shape (n,).
        way: how far the gripper is from where it began, as part of the furthest of the action, shape (n,); the progress where
            nothing is gripped.
        motion: number of the first action in which the gripper moves alike, shape (n,).
        late: when it was seen, by the clock, 0 in the first and 1 in the last frame, shape (n,); 0 where all actions begin at the
            same time, as where nothing is known of the times.
    """

    def __init__(self, scene: Scene, measurement: Measurement, forces: ForceScale | None = None) -> None:
        columns = [scene.fiducial_names.index(name) for name in measurement.fiducial_names]
        self.names = [*scene.fiducial_names, *(["force", "torque"] if forces else [])]
        shape = (len(measurement.positions), len(self.names), 3)
        self.measured, self._sigma, self._slow = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape)
        self.measured[:, columns] = measurement.positions
        stated = measurement.sigma(scene.noise_sigma)
        if stated is not None:
            self._sigma[:, columns] = stated
        self.scene, self.measurement, self.forces = scene, measurement, forces
        self.stated = stated is not None
        self.rest = np.zeros(shape[1:])
        self.rest[: len(scene.fiducials)] = scene.rest
        if forces is not None:
            self._take_forces(forces)
        self.about = np.where(np.isfinite(self.measured), self.measured, self.rest)
        self._ways, self._alike = np.full(shape[0], np.nan), np.zeros(shape[0], dtype=np.int64)
        self._late = normalised_time(measurement)
        moved = measurement.actions
        for action in moved:
            if action.grasp or action.boundary:
                self._ways[action.frames] = way(action, scene)
            self._alike[action.frames] = next(k for k, other in enumerate(moved) if same_motion(other, action))
        self._take(Seen.of(self.measured, normals_of(scene, measurement, shape[1])))

    def _take_forces(self, forces: ForceScale) -> None:
        """Force and torque as the last rows, where something is gripped."""
        gripped = np.zeros(len(self.measured), dtype=bool)
        for action in self.measurement.actions:
            gripped[action.frames] = bool(action.grasp)
        rows = forces.rows(self.measurement.wrenches)
        self.measured[gripped, -ROWS:] = rows[gripped]
        noise = np.repeat(force_noise(self.measurement), 3)
        self._sigma[:, -ROWS:] = forces.rows(noise)

    def _take(self, seen: Seen) -> None:
        measurement = self.measurement
        self.seen, mask = seen, seen.mask
        self.mask: NDArray[np.bool_] = mask
        self.values, self.sigma, self.slow = self.vector(self.measured), self._sigma[mask], self._slow[mask]
        frames, fiducials, axes = np.nonzero(self.mask)
        names = measurement.action_names
        actions = np.array([names.index(str(name)) for name in measurement.data["action"].values])
        self.frame, self.fiducial, self.axis = frames, fiducials, axes
        self.action, self.step = actions[frames], measurement.data["step"].values[frames]
        self.grasp = measurement.data["grasp"].values.astype(str)[frames]
        self.kind = self.kinds[fiducials]
        key = (self.action * len(self.names) + fiducials) * 3 + axes
        _, self.trajectory = np.unique(key, return_inverse=True)
        self.actions = names
        last = np.array([self.step[self.action == a].max(initial=1) for a in range(len(names))])
        self.progress = self.step / last[self.action]
        self.motion = self._alike[frames]
        self.late = self._late[frames]
        self.way = np.where(np.isfinite(self._ways[frames]), self._ways[frames], self.progress)

    def __len__(self) -> int:
        return len(self.values)

    def within(self, frames: NDArray[np.bool_]) -> Data:
        """The values of some frames, (frames,), alone."""
        other = copy(self)
        other._take(self.seen.within(frames))
        return other

    def with_noise(self, noise: Noise) -> Data:
        """The same values with another noise than the stated one, or with one where none is stated.

        Where the stated one is larger, the rest of it stays, as errors that persist: what is stated may be all that a position can
        be off, as with image correlation, whose bias is much larger than its noise.
        """
        other = copy(self)
        other._sigma, count = self._sigma.copy(), len(self.scene.fiducials)
        factors = np.array(noise.axes or (noise.factor,) * 3)
        sigma = self._sigma * factors if self.stated else np.full_like(self._sigma, noise.sigma)
        other._sigma[:, :count] = np.where(np.isfinite(self.measured), sigma, np.nan)[:, :count]
        if self.stated and factors.min() < 1:
            other._slow = np.zeros_like(self._sigma)
            rest = self._sigma * np.sqrt(1 - np.minimum(factors, 1.0) ** 2)
            other._slow[:, :count] = np.nan_to_num(rest)[:, :count]
        other._take(self.seen)
        return other

    def vector(self, positions: Any) -> Array:
        """The visible ones of values (frames, rows, 3, ...), shape (n, ...); of surface marks those along the normal."""
        return np.asarray(self.seen.take(positions))

    def spread(self, vector: Array) -> Array:
        """A vector of values back in shape (frames, rows, 3), NaN where nothing was seen."""
        result = np.full(self.mask.shape, np.nan)
        result[self.mask] = vector
        return result

    def noise(self, residual: Array) -> Array:
        """Standard deviation of every value, m; estimated from the residual (m) when none is known."""
        if np.isfinite(self.sigma).all():
            return self.sigma
        estimated = max(estimate_noise(self, residual), LEAST_NOISE)
        return np.where(self.of_position, estimated, self.sigma)

    @property
    def kinds(self) -> NDArray[np.int64]:
        """Kind of each row, shape (rows,), see `kind`."""
        return np.maximum(np.arange(len(self.names)) - len(self.scene.fiducials) + 1, 0)

    @property
    def along(self) -> NDArray[np.bool_]:
        """Which values are components along the normal of the surface, shape (n,)."""
        return np.asarray(np.isfinite(self.seen.normals[self.frame, self.fiducial, 0]))

    @property
    def tells_stiffness(self) -> bool:
        """Whether forces are known, those of the gripper or of loads: without any all stiffnesses may be another multiple."""
        loads = [load for action in self.measurement.actions for load in action.loads.values()]
        return self.forces is not None or any(load.any() for load in loads)

    @property
    def of_position(self) -> NDArray[np.bool_]:
        """Which values are positions, shape (n,)."""
        return self.kind == 0

    def moved(self, displacements: Array) -> Array:
        """What displacements (frames, fiducials, 3, k), m, of points do to the values, (n, k), m; to force and torque nothing."""
        whole = np.zeros((*self.mask.shape, displacements.shape[-1]))
        whole[:, : len(self.scene.fiducials)] = displacements
        return self.vector(whole)

    @property
    def points(self) -> Array:
        """Those of `about` that are positions, (frames, fiducials, 3), m."""
        return self.about[:, : len(self.scene.fiducials)]

    def rms(self, vector: Array) -> float:
        """Root mean square of those of values (n,) that are positions."""
        return float(np.sqrt(np.mean(vector[self.of_position] ** 2)))


def way(action: Action, scene: Scene) -> Array:
    """Distance of the gripper from rest in each frame, as part of the largest, shape (frames,).

    A turn counts by how far it would move the nearest fiducial, and a driven place by the mean distance of its points.
    """
    far = scene.rest - np.array(scene.grasps[action.grasp].centre) if action.grasp else np.zeros((1, 3))
    turned = (as_rotation(action.rotation) * as_rotation(action.rotation[0]).inv()).magnitude()
    gone = np.linalg.norm(action.translation, axis=1) + turned * np.linalg.norm(far, axis=1).min()
    gone = gone + sum(np.linalg.norm(moved, axis=2).mean(axis=1) for moved in action.boundary.values())
    return np.asarray(gone / max(float(gone.max()), 1e-12))


def frame_times(actions: Iterable[Action], count: int) -> Array:
    """When each of so many frames was seen, by the clock of its action, shape (count,), s."""
    times = np.zeros(count)
    for action in actions:
        times[action.frames] = action.clock
    return times


def normalised_time(measurement: Measurement) -> Array:
    """When each frame was seen, as part of the whole time; 0 where all actions begin at the same, shape (frames,)."""
    moved = measurement.actions
    times = frame_times(moved, measurement.data.sizes["frame"])
    begun = [float(action.clock[0]) for action in moved]
    apart = np.ptp(begun) if begun else 0.0
    return np.asarray((times - times.min()) / np.ptp(times)) if apart > 0 else np.zeros(len(times))


def same_motion(one: Action, other: Action) -> bool:
    """Whether gripper and driven places move alike in two actions, under the same loads."""
    if (one.grasp, len(one), set(one.loads)) != (other.grasp, len(other), set(other.loads)):
        return False
    pairs = [
        (one.translation, other.translation),
        (one.rotation, other.rotation),
        (one.clock - one.clock[0], other.clock - other.clock[0]),
    ]
    pairs += [(one.loads[place], other.loads[place]) for place in one.loads]
    pairs += [(moved, other.boundary[place]) for place, moved in one.boundary.items()]
    return all(np.allclose(a, b, rtol=0.0, atol=1e-9) for a, b in pairs)


def robust_noise(data: Data, rough: Array) -> Noise | None:
    """The noise that the part of a residual has that is like noise, (n,), m; None without three steps in a row.

    From the median of the sizes of second differences along each trajectory: what is smooth drops out, and what jumps counts once.
    The standard error is that of a median of Gaussian values, half as many as there are differences, for neighbours go together.
    Axes of which another noise is stated have a factor each. A coordinate that never changes tells of none.
    """
    if not data.stated:
        return _noise_of(data, rough, 1.0)
    found = {axes: _noise_of(data, rough, data.sigma, axes) for axes in _alike_axes(data)}
    known = {axes: noise for axes, noise in found.items() if noise is not None}
    if len(found) == 1 or not known:
        return next(iter(known.values()), None)
    factors = [1.0] * 3
    for axes, noise in known.items():
        for axis in axes if noise.surprising else ():
            factors[axis] = noise.factor
    return replace(max(known.values(), key=lambda noise: noise.deviation), axes=(factors[0], factors[1], factors[2]))


def _alike_axes(data: Data) -> list[tuple[int, ...]]:
    """Axes of positions that were measured, those together of which the same noise is stated."""
    groups: dict[float, list[int]] = {}
    for axis in np.unique(data.axis[data.of_position]):
        sigma = data.sigma[data.of_position & (data.axis == axis)]
        groups.setdefault(float(f"{np.sqrt(np.mean(sigma**2)):.6g}"), []).append(int(axis))
    return [tuple(axes) for axes in groups.values()]


def _noise_of(data: Data, rough: Array, scale: Array | float, axes: Iterable[int] = range(3)) -> Noise | None:
    """The noise of some axes, in units of `scale`, (n,), m."""
    some = data.of_position & np.isin(data.axis, list(axes))
    # Of a measurement in which nothing changes every coordinate counts.
    moving = any(map(_changes, _along_trajectories(data, data.values)))
    changing = [not moving or _changes(values) for values in _along_trajectories(data, data.values, some)]
    parts = _along_trajectories(data, np.asarray(rough / scale), some)
    found = [np.diff(v, 2) for v, change in zip(parts, changing, strict=True) if change and len(v) > 2]
    if not found:
        return None
    differences = np.abs(np.concatenate(found)) / math.sqrt(6)
    factor = max(float(_PER_MEDIAN * np.median(differences)), 1e-12)
    known = np.sqrt(np.mean(np.broadcast_to(scale, some.shape)[some] ** 2))
    error = 1.17 / math.sqrt(max(len(differences) / 2, 1.0))
    return Noise(factor * float(known), factor if data.stated else 1.0, error)


def _changes(values: Array) -> bool:
    return len(values) > 0 and bool(np.ptp(values) > 0)


def _along_trajectories(data: Data, values: Array, some: NDArray[np.bool_] | None = None) -> list[Array]:
    """Values (n,) along each trajectory of a position, or of some of them."""
    order = np.lexsort((data.step, data.trajectory))
    order = order[(data.of_position if some is None else some)[order]]
    return np.split(values[order], np.flatnonzero(np.diff(data.trajectory[order])) + 1)


def estimate_noise(data: Data, residual: Array) -> float:
    """White noise in a residual, m, from its second differences along each trajectory: what is smooth drops out.

    Without three steps in a row the RMS of the residual stands for it.
    """
    found = [np.diff(values, 2) / np.sqrt(6) for values in _along_trajectories(data, residual) if len(values) > 2]
    if not found:
        return data.rms(residual)
    return float(np.sqrt(np.mean(np.concatenate(found) ** 2)))


def force_noise(measurement: Measurement) -> tuple[float, float]:
    """Standard deviations of a force, N, and of a torque, N m.

    What is not stated is seen in third differences along the steps of each action, in which a smooth course drops out.
    """
    stated = measurement.wrench_sigma, measurement.torque_sigma
    force, torque = (
        _seen(measurement, measurement.wrenches[:, part]) if known is None else known
        for known, part in zip(stated, (slice(3), slice(3, 6)), strict=True)
    )
    return force, torque


def _seen(measurement: Measurement, values: Array) -> float:
    """Of values (frames, 3)."""
    differences = [np.diff(values[action.frames], 3, axis=0).ravel() for action in measurement.actions if action.grasp]
    sizes = np.abs(np.concatenate([np.zeros(0), *differences]))
    sizes = sizes[np.isfinite(sizes)]
    rough = _PER_MEDIAN * float(np.median(sizes)) / _THIRD if len(sizes) else 0.0
    return max(rough, PRIORS.force_sensor * float(np.nanmax(np.abs(values), initial=0.0)), 1e-12)
