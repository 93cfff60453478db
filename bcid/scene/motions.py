"""The gripper motions of the benchmark (design of Boonvisut & Cavusoglu 2014), by name, in the slab's axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bcid.base.errors import InputError, nearest
from bcid.scene.action import Action
from bcid.scene.rotation import as_quaternion, conjugated, rotate, slerp

Array = NDArray[np.float64]
Path = tuple[Array, Array]

_UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


def semicircle() -> list[Path]:
    """30 steps: three half circles of radius 10 mm."""
    phi = np.arange(1, 11) * np.pi / 10
    rise, run, zero = 0.010 * np.sin(phi), 0.010 - 0.010 * np.cos(phi), np.zeros(10)
    arcs = [np.c_[run, rise, zero], np.c_[zero + 0.020, rise, -run], np.c_[zero + 0.020, rise, run - 0.020]]
    return [_straight(np.vstack([np.zeros(3), *arcs]))]


def complex_motion() -> list[Path]:
    """30 steps: 28 mm along (1, 1, 1), 29 mm along -z, a twist of 30 degrees about x."""
    along = np.arange(1, 11)[:, None] / 10
    first = along * 0.028 * np.ones(3) / np.sqrt(3)
    second = first[-1] + along * np.array([0.0, 0.0, -0.029])
    points = np.vstack([np.zeros(3), first, second, np.tile(second[-1], (10, 1))])
    turns = np.maximum(np.arange(-20.0, 11.0), 0.0) * 3.0
    return [(points, about_x(turns))]


def pull() -> list[Path]:
    """10 steps of 2 mm along x."""
    return [_straight(np.arange(11)[:, None] * np.array([0.002, 0.0, 0.0]))]


def arc(side: float = 1.0) -> list[Path]:
    """Gradual tangent pull: 20 steps of about 2 mm along a quarter circle that turns from x towards z."""
    radius = 0.040 / (np.pi / 2)
    phi = np.arange(21) * np.pi / 40
    return [_straight(np.c_[radius * np.sin(phi), np.zeros(21), side * radius * (1 - np.cos(phi))])]


def arc_away() -> list[Path]:
    """As `arc`, but turning towards -z: a retraction from anchors at large z, where `arc` folds the body."""
    return arc(-1.0)


def twist() -> list[Path]:
    """Twist and pull: 10 steps of 2 mm along x, each with 3 degrees about x."""
    return [(np.arange(11)[:, None] * np.array([0.002, 0.0, 0.0]), about_x(np.arange(11.0) * 3.0))]


def directions() -> list[Path]:
    """Exploration: six actions, 8 mm along +-x, +-y, +-z in 4 steps and back to rest in 4."""
    there = np.array([0, 1, 2, 3, 4, 3, 2, 1, 0]) * 0.002
    return [_straight(there[:, None] * sign * axis) for axis in np.eye(3) for sign in (1.0, -1.0)]


MOTIONS: dict[str, Callable[[], list[Path]]] = {
    "semicircle": semicircle,
    "complex": complex_motion,
    "pull": pull,
    "arc": arc,
    "arc-away": arc_away,
    "twist": twist,
    "directions": directions,
}


def motion(
    name: str,
    grasp: str,
    first: int = 1,
    amplitude: float | None = None,
    steps: int | None = None,
    direction: Sequence[float] | None = None,
) -> list[Action]:
    """The actions of a named motion with a grasp; actions and frames are numbered from `first` and 0.

    Args:
        name: one of `MOTIONS`.
        grasp: name of the grasp.
        first: number of the first action.
        amplitude: how far the gripper goes from rest at most, m; by default as in the benchmark. Turns stay as they are.
        steps: of each action, besides rest; by default as in the benchmark.
        direction: where the motion's x axis goes, shape (3,), of any length; its other axes are turned along the shortest way.

    Raises:
        InputError: there is no motion of that name, or a number makes no sense.
    """
    if name not in MOTIONS:
        raise InputError(f"unknown motion '{name}'; {nearest(name, MOTIONS)}")
    if amplitude is not None and not (np.isfinite(amplitude) and amplitude > 0):
        raise InputError(f"amplitude {amplitude:g} m: must be above 0")
    if steps is not None and steps < 1:
        raise InputError(f"steps {steps}: must be at least 1")
    paths = MOTIONS[name]()
    if steps is not None:
        paths = [_resampled(path, steps) for path in paths]
    if amplitude is not None:
        far = max(float(np.linalg.norm(points, axis=1).max()) for points, _ in paths)
        paths = [(points * (amplitude / far), turns) for points, turns in paths]
    if direction is not None:
        paths = [_turned(path, direction) for path in paths]
    return actions(paths, grasp, first)


def _resampled(path: Path, steps: int) -> Path:
    """The path in so many steps, along straight lines and shortest arcs between its own."""
    points, turns = path
    at = np.linspace(0, len(points) - 1, steps + 1)
    before = np.minimum(at.astype(int), len(points) - 2)
    part = at - before
    moved = points[before] + part[:, None] * (points[before + 1] - points[before])
    return moved, slerp(turns[before], turns[before + 1], part)


def _turned(path: Path, direction: Sequence[float]) -> Path:
    """The path in axes whose x goes along a direction."""
    wanted = np.asarray(direction, dtype=float)
    if wanted.shape != (3,) or not np.isfinite(wanted).all() or not np.linalg.norm(wanted) > 0:
        raise InputError(f"direction {tuple(direction)}: must be three numbers that are not all zero")
    turn = as_quaternion(Rotation.align_vectors(wanted[None], np.eye(3)[:1])[0])
    points, turns = path
    return rotate(turn, points), conjugated(turn, turns)


def actions(paths: list[Path], grasp: str, first: int = 1) -> list[Action]:
    """Actions from paths of translations (steps, 3) and rotations (steps, 4), one after the other in the frame axis."""
    result = []
    start = 0
    for i, (translation, rotation) in enumerate(paths):
        count = len(translation)
        result.append(Action(str(first + i), start + np.arange(count), np.arange(count), grasp, translation, rotation))
        start += count
    return result


def about_x(degrees: Array) -> Array:
    """Unit quaternions of turns about x, shape (steps, 4)."""
    half = np.radians(degrees) / 2
    return np.c_[np.cos(half), np.sin(half), np.zeros((len(half), 2))]


def _straight(points: Array) -> Path:
    return points, np.tile(_UNTURNED, (len(points), 1))
