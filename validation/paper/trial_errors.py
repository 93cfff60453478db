"""What is wrong in a trial: drawn from the seed of the study and the number of the trial alone.

Trials of the same number in different cells differ by what is varied and by nothing else: each kind of error has random numbers
of its own, which a standard deviation only scales.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.measurement import Action
from bcid.scene import Scene
from bcid.scene.rotation import conjugated, from_vector, rotate
from validation.paper.condition import Condition
from validation.rendering.vectors import unit

Array = NDArray[np.float64]
_KINDS = ("noise", "registration", "camera", "robot_turn", "robot_noise", "grasp_error", "placement", "pictures")
# Every grasp succeeds: the gripper is never further off than this, m.
_FURTHEST = 0.015


def numbers(kind: str, number: int, seed: int) -> np.random.Generator:
    """The random numbers of a kind of error in a trial."""
    return np.random.default_rng([seed, number, _KINDS.index(kind)])


def differs(condition: Condition) -> bool:
    """Whether the body, or how it is moved, differs from trial to trial."""
    return bool(body_differs(condition) or condition.robot_turn or condition.robot_noise)


def body_differs(condition: Condition) -> bool:
    """Whether the body differs from trial to trial."""
    return bool(condition.grasp_error or condition.placement)


def true_actions(condition: Condition, number: int, seed: int) -> list[Action]:
    """How the gripper really moves: turned as a whole, and elsewhere than commanded in each step but at rest."""
    actions = condition.actions()
    if condition.robot_turn:
        drawn = numbers("robot_turn", number, seed)
        axis, spin = unit(drawn.normal(size=3)), drawn.normal()
        actions = [turned(action, from_vector(condition.robot_turn * spin * axis)) for action in actions]
    if condition.robot_noise:
        drawn = numbers("robot_noise", number, seed)
        actions = [_shaken(action, condition.robot_noise, drawn) for action in actions]
    return actions


def _shaken(action: Action, sigma: float, drawn: np.random.Generator) -> Action:
    off = sigma * drawn.normal(size=action.translation.shape)
    off[action.steps == 0] = 0.0
    return replace(action, translation=action.translation + off)


def true_scene(condition: Condition, scene: Scene, number: int, seed: int) -> Scene:
    """The body as it really is, with the truth's elements as its only level."""
    true = condition.truth(scene)
    if condition.grasp_error:
        off = condition.grasp_error * numbers("grasp_error", number, seed).normal(size=2)
        true = _held_elsewhere(true, condition.grasp, np.clip(off, -_FURTHEST, _FURTHEST))
    if condition.placement:
        off = condition.placement * numbers("placement", number, seed).normal(size=(len(true.fiducials), 2))
        places = {
            name: (x + dx, y, z + dz) for (name, (x, y, z)), (dx, dz) in zip(true.fiducials.items(), off, strict=True)
        }
        true = replace(true, fiducials=places)
    return true


def _held_elsewhere(scene: Scene, grasp: str, off: Sequence[float] | Array) -> Scene:
    x, z = float(off[0]), float(off[1])
    held = scene.grasps[grasp]
    moved = replace(held, centre=(held.centre[0] + x, held.centre[1], held.centre[2] + z))
    parameters = scene.parameters | {"shift_x": x / scene.length_unit, "shift_z": z / scene.length_unit}
    return replace(scene, grasps={grasp: moved}, parameters=parameters)


def seen_positions(condition: Condition, true: Array, middle: Array, number: int, seed: int) -> Array:
    """Positions (frames, markers, 3), m, as they are measured: turned and scaled about `middle` (3,), shifted, and with noise."""
    drawn = numbers("camera", number, seed)
    axis, spin, scale = unit(drawn.normal(size=3)), drawn.normal(), drawn.normal()
    about = from_vector(condition.camera_turn * spin * axis)
    seen = middle + (1 + condition.camera_scale * scale) * rotate(about, true - middle)
    shift = numbers("registration", number, seed).normal(size=3)
    white = numbers("noise", number, seed).normal(size=true.shape)
    return np.asarray(seen + condition.registration * shift + condition.noise * white)


def turned(action: Action, turn: Array) -> Action:
    """The action in a frame that is turned: its translations and the axes of its rotations."""
    return replace(action, translation=rotate(turn, action.translation), rotation=conjugated(turn, action.rotation))
