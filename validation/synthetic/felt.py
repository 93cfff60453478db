"""What a gripper feels in a case: the force of a body that is not as stiff as its scene says, by a sensor that is not exact."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.forms.model import Model
from bcid.forms.simulate import with_wrenches
from bcid.measurement import Measurement
from bcid.scene import Scene
from validation.synthetic.chance import Rng

Array = NDArray[np.float64]
# Standard deviations: of the logarithm of the stiffness, of the sensor's gain, and of what it shows without a force and of its
# noise as parts of the largest force and torque.
STIFFNESS, GAIN, BIAS, NOISE = 0.2, 0.01, 0.005, 0.01


def stiffened(scene: Scene, factor: float) -> Scene:
    """The scene of a body that is so many times as stiff."""
    constants = {name: f"{factor * value!r} Pa" for name, value in Model.of(scene).stiffnesses.items()}
    return replace(scene, material=replace(scene.material, values=scene.material.values | constants))


@dataclass(frozen=True)
class Felt:
    """How stiff a body is, and how its forces are reported.

    Attributes:
        stiffness: of the body, in units of the scene's.
        gain: of the sensor.
        bias: what it shows without a force, as parts of the largest force (three) and torque (three).
    """

    stiffness: float
    gain: float = 1.0
    bias: tuple[float, ...] = (0.0,) * 6

    @classmethod
    def draw(cls, rng: Rng, exact: bool) -> Felt:
        """Any; with an exact sensor, or one that is slightly wrong."""
        stiffness = float(np.exp(STIFFNESS * rng.normal()))
        gain, bias = 1 + GAIN * rng.normal(), BIAS * rng.normal(size=6)
        return cls(stiffness) if exact else cls(stiffness, float(gain), tuple(map(float, bias)))

    def scene(self, scene: Scene) -> Scene:
        """As stiff as the body is."""
        return stiffened(scene, self.stiffness)

    def measured(self, seen: Measurement, wrenches: Array, rng: Rng) -> Measurement:
        """A measurement with true force (N) and torque (N m) of the gripper, shape (frames, 6), as they are reported."""
        largest = np.repeat([np.abs(wrenches[:, part]).max() for part in (slice(3), slice(3, 6))], 3)
        reported = self.gain * wrenches + np.array(self.bias) * largest
        return with_wrenches(seen, reported, NOISE * float(largest[0]), rng)
