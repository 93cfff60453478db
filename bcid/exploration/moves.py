"""The pulls that a robot may make: a grasp, a direction, how far, and back to rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bcid.base.errors import InputError
from bcid.measurement import Action
from bcid.scene import Limits, Scene

# Pause between two steps, s.
SECONDS = 1.0


@dataclass(frozen=True)
class Move:
    """A straight pull and back.

    Attributes:
        grasp: what is held.
        direction: its name in the scene.
        amplitude: how far, m.
    """

    grasp: str
    direction: str
    amplitude: float

    def __str__(self) -> str:
        return f"grasp {self.grasp} along {self.direction} by {self.amplitude * 1e3:.3g} mm and back"

    def action(self, limits: Limits, name: str = "1") -> Action:
        """The commanded motion; its frames are numbered from 0."""
        there = np.arange(limits.steps + 1) / limits.steps
        part = np.concatenate([there, there[-2::-1]])
        count = len(part)
        path = part[:, None] * self.amplitude * np.array(limits.directions[self.direction])
        unturned = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
        numbers = np.arange(count)
        return Action(name, numbers, numbers, self.grasp, path, unturned, times=SECONDS * numbers.astype(float))


def limits_of(scene: Scene) -> Limits:
    """The limits of a scene.

    Raises:
        InputError: it states none, or has no grasp.
    """
    if scene.limits is None:
        raise InputError(
            f"{scene.source}: has no [explore] table: nothing says how far a robot may go. Add one, as\n"
            '  [explore]\n  displacement = "8 mm"'
        )
    scene.check_undriven("explored")
    if not scene.grasps:
        raise InputError(f"{scene.source}: has no grasp: there is nothing to pull at")
    return scene.limits


def moves(scene: Scene) -> list[Move]:
    """Every pull that a scene allows, the far ones first.

    Raises:
        InputError: see `limits_of`.
    """
    limits = limits_of(scene)
    return [Move(g, d, a) for a in limits.amplitudes for g in scene.grasps for d in limits.directions]


def cost(move: Move, before: Move | None, limits: Limits) -> float:
    """What a pull costs after another one."""
    return limits.cost + (limits.regrasp if before is not None and before.grasp != move.grasp else 0.0)
