"""An action: one motion of the gripper, with the loads and times that go with it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Action:
    """One motion of the gripper, as the forward model needs it.

    Attributes:
        name: the action's name.
        frames: positions in the measurement's frame axis, shape (steps,).
        steps: step numbers, shape (steps,); the first is 0.
        grasp: name of the grasp, or "" when nothing holds the body.
        translation: of the gripper from its rest pose, shape (steps, 3), m.
        rotation: unit quaternions (w, x, y, z) about the rest centre of the grasp, shape (steps, 4).
        loads: known dead loads by place, each of shape (steps, 3), N.
        times: of the steps, shape (steps,), s; None for one second per step.
        numbers: of the frames in the whole measurement, where only some of its frames are looked at; None where all are.
        boundary: displacements of the points that drive a place, by place, each of shape (steps, points, 3), m.
    """

    name: str
    frames: NDArray[np.int64]
    steps: NDArray[np.int64]
    grasp: str
    translation: Array
    rotation: Array
    loads: dict[str, Array] = field(default_factory=dict)
    times: Array | None = None
    numbers: NDArray[np.int64] | None = None
    boundary: dict[str, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.frames)

    def until(self, count: int) -> Action:
        """Its first steps."""
        return replace(
            self,
            frames=self.frames[:count],
            steps=self.steps[:count],
            translation=self.translation[:count],
            rotation=self.rotation[:count],
            loads={place: load[:count] for place, load in self.loads.items()},
            boundary={place: moved[:count] for place, moved in self.boundary.items()},
            times=None if self.times is None else self.times[:count],
            numbers=self.numbered[:count],
        )

    @property
    def numbered(self) -> NDArray[np.int64]:
        """Numbers of the frames in the whole measurement, shape (steps,)."""
        return self.frames if self.numbers is None else self.numbers

    @property
    def clock(self) -> Array:
        """Times of the steps, s."""
        return self.steps.astype(float) if self.times is None else self.times
