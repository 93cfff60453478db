"""Foreign recordings, read through a mapping file into what a measurement holds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import softmax

from bcid.base.errors import InputError, Problems, nearest
from bcid.base.units import percent
from bcid.measurement.contents import WRENCH, Contents, Units, frames_dataset, with_noise
from bcid.measurement.folder import read_grasps
from bcid.measurement.force_recording import ForceRecording
from bcid.measurement.mapping import Mapping, read_mapping
from bcid.measurement.slips import FACTORS, rigid_motion
from bcid.measurement.tracks import Tracks, read_points_of, read_table

Array = NDArray[np.float64]

# Coordinates above this, in length_unit, are taken for it, so that they can be turned.
_FAR = 1e100
# Prior probability that markers to align by were confused, and the certainties above which that is refused or said.
_SLIP, _REFUSED, _SAID = 0.01, 0.99, 0.5
# How well people know where markers stand, part of their span.
_PLACED = 0.01
# A rigid motion that misses its markers by more than this part of their span (RMS) is none; half as much is said.
_LIMIT = 0.2
# A marker further away than this many spans is none.
_FURTHEST = 1e12
# Cosine of the angle by which what was not measured may be off an axis of the body frame: 2.6 degrees.
_STRAIGHT = 0.999
# Markers that tell a rigid motion, and by which part of their span (RMS) they may miss it.
_RIGID, _GIVES = 3, 0.1


def read_mapped(path: Path) -> Contents:
    """Measurement from a mapping file and the recording it names.

    Raises:
        InputError: with every problem of the mapping, or of the recording.
    """
    mapping = read_mapping(path)
    recording = read_points_of(mapping) if mapping.labelled else read_table(mapping)
    recording.select(mapping.frames, mapping.file)
    if not recording.actions:
        raise InputError(f"{path}: frames: no frame of {mapping.file.name} is left; check first, last and every")
    if mapping.pixel is not None:
        factor = mapping.pixel / mapping.length
        recording.positions = {name: values * factor for name, values in recording.positions.items()}
    turn, shift = _to_body_frame(recording, mapping)
    if recording.pose is not None:
        _relative(recording, recording.pose, mapping, turn, shift)
    if "grasps" in mapping.table:
        take_grasps(recording, mapping.path.parent / mapping.table["grasps"], mapping.units)
    if mapping.table.get("gripper"):
        _follow(recording, mapping)
    if mapping.table.get("force"):
        words = str(mapping.table.get("delimiter", ",")), str(mapping.table.get("decimal", "."))
        recording.wrench = ForceRecording.read(mapping.path.parent, mapping.table["force"], *words).at(recording)
    return _contents(recording, mapping)


def _to_body_frame(recording: Tracks, mapping: Mapping) -> tuple[Array, Array]:
    """Apply the rigid motion that takes the markers of `align`, in the first frame, to where they are said to be; returns it."""
    if not mapping.align:
        return np.eye(3), np.zeros(3)
    names = [name for name in mapping.align if name in recording.positions]
    unseen = _unmeasured(recording)
    for axis in unseen:
        # What is seen lies in a plane.
        for values in recording.positions.values():
            values[np.isfinite(values).any(axis=1), axis] = 0.0
    here = np.array([recording.positions[name][0] for name in names]).reshape(-1, 3)
    there = np.array([mapping.align[name] for name in names]).reshape(-1, 3)
    try:
        recording.remarks += _oddities(here, there, names)
    except InputError as error:
        raise InputError(f"{mapping.path}: align: {error}") from None
    recording.aligned = _misfit(here, there) * mapping.length
    turn, shift = rigid_motion(here, there)
    gone = [_along(turn[:, axis], mapping) for axis in unseen]
    for name, values in recording.positions.items():
        turned = np.clip(values, -_FAR, _FAR) @ turn.T + shift
        turned[:, gone] = np.nan
        recording.positions[name] = turned
    return turn, shift


def _oddities(here: Array, there: Array, names: Sequence[str]) -> list[str]:
    """What is odd about the rigid motion from markers seen at `here` to where they are said to be, `there`, (n, 3), in one unit.

    Raises:
        InputError: they are too few, stand on one line, or cannot be brought onto each other.
    """
    if len(names) < 3 or not np.isfinite(here).all():
        raise InputError("its markers must all be seen in the first frame, with all three coordinates")
    span = max(float(np.linalg.norm(np.ptp(there, axis=0))), 1e-300)
    if (np.abs(here) > _FURTHEST * span).any():
        furthest = names[int(np.abs(here).max(axis=1).argmax())]
        raise InputError(f"marker {furthest} is absurdly far away in the first frame")
    sizes = np.linalg.svd((here - here.mean(axis=0)).T @ (there - there.mean(axis=0)), compute_uv=False)
    if sizes[1] < 1e-9 * sizes[0]:
        raise InputError("its markers stand on one line; choose others")
    rms = _misfit(here, there)
    told = f"the rigid motion misses its markers by {rms:.3g} (RMS distance), where they span {span:.3g}"
    chance, text = _confused(here, there, names, span)
    if chance > _REFUSED:
        raise InputError(f"{told}: {text}")
    if chance > _SAID:
        return [f"align: {told}: {text}"]
    if rms > _LIMIT * span:
        rule = "check the places and the markers, which must be those of the first frame, and length_unit"
        raise InputError(f"{told}: {rule}")
    return [f"align: {told}"] if rms > 0.5 * _LIMIT * span else []


def _misfit(here: Array, there: Array) -> float:
    """RMS distance that the best rigid motion leaves."""
    turn, shift = rigid_motion(here, there)
    return float(np.sqrt(np.mean(np.sum((here @ turn.T + shift - there) ** 2, axis=1))))


def _confused(here: Array, there: Array, names: Sequence[str], span: float) -> tuple[float, str]:
    """With what probability the markers were confused, and how; the scale of the misfit is not known."""
    tried = list(_confusions(here, there, names))
    left = np.array([_misfit(here, there), *(misfit for _, misfit in tried)])
    evidence = -0.5 * (3 * len(here) - 6) * np.log(left**2 + (_PLACED * span) ** 2)
    prior = np.array([math.log1p(-_SLIP), *([math.log(_SLIP / len(tried))] * len(tried))])
    shares = softmax(evidence + prior)
    return float(1 - shares[0]), tried[int(shares[1:].argmax())][0]


def _confusions(here: Array, there: Array, names: Sequence[str]) -> Iterator[tuple[str, float]]:
    for i, j in itertools.combinations(range(len(here)), 2):
        order = list(range(len(here)))
        order[i], order[j] = j, i
        yield f"markers {names[i]} and {names[j]} look swapped", _misfit(here[order], there)
    for factor in FACTORS:
        many = f"{factor:g} times too small" if factor > 1 else f"{1 / factor:g} times too large"
        yield f"the places of [align] look {many}: they are in length_unit", _misfit(here, there * factor) / factor
    yield "the axes look reversed (another handedness): write one of them with the other sign", _misfit(-here, there)


def _unmeasured(recording: Tracks) -> list[int]:
    """Axes along which no marker was ever measured."""
    values = list(recording.positions.values())
    seen: NDArray[np.bool_] = np.array([np.isfinite(one).any(axis=0) for one in values], dtype=bool).reshape(-1, 3)
    return [k for k in range(3) if seen.any() and not seen[:, k].any()]


def _along(direction: Array, mapping: Mapping) -> int:
    """The axis of the body frame along which nothing was measured."""
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) < _STRAIGHT:
        found = " ".join(f"{x:.3f}" for x in direction)
        raise InputError(
            f"{mapping.path}: align: along ({found}) of the body frame nothing was measured; only along one of its axes can "
            "a coordinate be missing: turn the scene so that two of its axes lie in the image"
        )
    return axis


def _relative(recording: Tracks, pose: Array, mapping: Mapping, turn: Array, shift: Array) -> None:
    """Translation and rotation of the gripper from its rest pose, about the centre of the grasp, of its absolute poses (frames, 7).

    A rigid body at p with rotation R takes the centre c of the grasp to R_t R_0^-1 (c - p_0) + p_t; without `grasp_centre` its own
    origin is the centre.
    """
    if not np.isfinite(pose).all():
        lost = int((~np.isfinite(pose).all(axis=1)).sum())
        raise InputError(
            f"{mapping.file}: columns.pose: is not known in {lost} of {len(pose)} frames; choose others by [frames], "
            "or fill the gaps where it was recorded"
        )
    if (abs(np.linalg.norm(pose[:, 3:], axis=1) - 1) > 1e-3).any():
        raise InputError(f"{mapping.file}: columns.pose: expected x, y, z and a unit quaternion (w, x, y, z)")
    place = pose[:, :3] @ turn.T + shift
    angle = Rotation.from_matrix(turn) * Rotation.from_quat(pose[:, 3:], scalar_first=True)
    rest = recording.rest
    moved = angle * angle[rest].inv()
    centre = np.array(mapping.table["grasp_centre"], dtype=float) if "grasp_centre" in mapping.table else place[rest]
    recording.translation = moved.apply(centre - place[rest]) + place - centre
    rotation = moved.as_quat(scalar_first=True)
    # Exactly at rest where it is: rounding would be taken for a motion.
    first = rest == np.arange(len(rest))
    recording.translation[first], rotation[first] = 0.0, (1.0, 0.0, 0.0, 0.0)
    recording.rotation = rotation


def _follow(recording: Tracks, mapping: Mapping) -> None:
    """Translation and rotation of the gripper from the rigid motion of the markers on it, about the centre of the grasp.

    Between rest and each frame by least squares (Arun, Huang & Blostein, IEEE Trans. Pattern Anal. Mach. Intell. 9, 1987, 698).
    """
    names = list(mapping.table["gripper"])
    seen = np.stack([recording.positions[name] for name in names], axis=1)
    lost: NDArray[np.bool_] = np.asarray(~np.isfinite(seen).all(axis=2))
    if ((~lost).sum(axis=1) < _RIGID).any():
        frame = int(np.flatnonzero((~lost).sum(axis=1) < _RIGID)[0])
        raise InputError(
            f"{mapping.file}: gripper: fewer than {_RIGID} of its markers are seen, with all three coordinates, in step "
            f"{recording.steps[frame]} of action {recording.actions[frame]}; choose other frames by [frames]"
        )
    centre, misses = np.array(mapping.table["grasp_centre"], dtype=float), []
    recording.translation, turns = np.zeros((len(seen), 3)), []
    for i, rest in enumerate(recording.rest):
        both = np.flatnonzero(~(lost[i] | lost[rest]))
        here, there = seen[rest][both], seen[i][both]
        span = float(np.linalg.norm(np.ptp(here, axis=0))) if len(both) else 0.0
        if len(both) < _RIGID or np.linalg.svd(here - here.mean(axis=0), compute_uv=False)[1] < 1e-6 * span:
            raise InputError(
                f"{mapping.file}: gripper: its markers stand on one line in action {recording.actions[i]}; choose others"
            )
        turn, shift = rigid_motion(here, there) if i > rest else (np.eye(3), np.zeros(3))
        recording.translation[i] = turn @ centre + shift - centre
        turns.append(turn)
        misses.append(_misfit(here, there) / span)
    if max(misses) > _GIVES:
        raise InputError(
            f"{mapping.file}: gripper: its markers do not move as one rigid body: they are off by {percent(max(misses))} of "
            f"their span in step {recording.steps[int(np.argmax(misses))]}; are all of them on the gripper?"
        )
    recording.rotation = Rotation.from_matrix(np.array(turns)).as_quat(scalar_first=True)


def _contents(recording: Tracks, mapping: Mapping) -> Contents:
    names = mapping.fiducials
    if not len(names):
        raise InputError(f"{mapping.file}: holds no marker; was it exported with its markers?")
    frames = list(zip(recording.actions, recording.steps, strict=True))
    starts = {action: time for (action, step), time in zip(frames, recording.times, strict=True) if step == 0}
    times = [(time - starts[a]) * mapping.time for (a, _), time in zip(frames, recording.times, strict=True)]
    positions = np.stack([recording.positions[name] for name in names], axis=1) * mapping.length
    if not np.isfinite(positions).any():
        raise InputError(f"{mapping.file}: no fiducial was seen in any of the chosen frames")
    data = frames_dataset(frames, times, names, positions)
    grasp = str(mapping.table.get("grasp", ""))
    if recording.grasps or grasp:
        data["grasp"] = ("frame", recording.grasps or [grasp] * len(frames))
    if recording.translation is not None:
        data["translation"] = (("frame", "axis"), recording.translation * mapping.length)
    if recording.rotation is not None:
        norms = np.linalg.norm(recording.rotation, axis=1, keepdims=True)
        if (abs(norms - 1) > 1e-3).any():
            raise InputError(f"{mapping.file}: columns.rotation: expected unit quaternions (w, x, y, z)")
        data["rotation"] = (("frame", "quaternion"), recording.rotation / norms)
    if recording.wrench is not None:
        units = [mapping.force] * 3 + [mapping.force * mapping.length] * 3
        data["wrench"] = (("frame", "component"), recording.wrench * units)
        data = data.assign_coords(component=WRENCH)
    data, noise = with_noise(data, mapping.sigmas[0])
    about = mapping.units, str(mapping.table.get("description", "")), str(mapping.path)
    known = Contents(data, noise, mapping.sigmas[1], *about, torque_sigma=mapping.sigmas[2])
    sigma = mapping.table["pixels"].get("uncertainty")
    if sigma is not None:
        known = replace(known, scale_sigma=float(sigma), scale_of_gripper=bool(mapping.table.get("gripper")))
    return replace(known, remarks=tuple(recording.remarks), aligned=recording.aligned)


def take_grasps(recording: Tracks, path: Path, units: Units) -> None:
    """Give every frame of a recording the pose that a file has for its action and step, in `units`.

    Raises:
        InputError: the file is damaged, or has other actions or steps than the recording.
    """
    actions = read_grasps(path, units)
    problems = Problems(f"motions {path}")
    frames = list(zip(recording.actions, recording.steps, strict=True))
    for action in actions:
        known, own = {int(step) for step in action.steps}, {step for other, step in frames if other == action.name}
        if not own:
            hint = nearest(action.name, dict.fromkeys(recording.actions))
            problems.add(path, f"action '{action.name}' is not in the recording; {hint}")
            continue
        missing, more = "no pose for step {}", "a pose for step {}, which the recording has not"
        for steps, said in ((own - known, missing), (known - own, more)):
            if steps:
                few = ", ".join(map(str, sorted(steps)[:5])) + (", ..." if len(steps) > 5 else "")
                rule = "steps count the frames that are used, from rest, which is 0"
                problems.add(path, f"action {action.name}: holds {said.format(few)}; {rule}")
    problems.raise_if_any()
    poses = {
        (action.name, int(step)): (action.grasp, *pose)
        for action in actions
        for step, *pose in zip(action.steps, action.translation, action.rotation, strict=True)
    }
    still = "", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    chosen = [poses.get(frame, still) for frame in frames]
    recording.grasps = [grasp for grasp, _, _ in chosen]
    recording.translation = np.array([place for _, place, _ in chosen]) / units.factors[0]
    recording.rotation = np.array([turn for _, _, turn in chosen])
