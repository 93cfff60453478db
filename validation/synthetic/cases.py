"""A case of the hidden study: a body, which patches hold it, how it is pulled, how noisy it is seen, and what is hidden."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bcid.measurement import Action
from bcid.scene.motions import actions
from bcid.scene.rotation import from_vector
from validation.synthetic.conditions import Conditions
from validation.synthetic.study_body import StudyBody, Vector

if TYPE_CHECKING:
    from validation.synthetic.felt import Felt
    from validation.synthetic.inexact import Inexact

Array = NDArray[np.float64]

KINDS = ("none", "one", "two", "outside")
OUTSIDE = ("second_grasp", "warming", "tear")

# Size of a hidden effect in units of noise.
SIZES = (0.5, 10.0)
# Between two actions the body rests so long, s: the clock runs on.
PAUSE = 5.0


@dataclass(frozen=True)
class Motion:
    """One action: a pull along a direction, perhaps back again, perhaps with a twist.

    Attributes:
        grasp: what is held.
        direction: name of one of the body's ways.
        along: its unit vector.
        amplitude: how far, m.
        steps: number of steps.
        back: whether the second half of the steps leads back to rest.
        twist: final turn about each axis (rotation vector), degrees.
        seconds: per step.
    """

    grasp: str
    direction: str
    along: Vector
    amplitude: float
    steps: int
    back: bool = False
    twist: Vector = (0.0, 0.0, 0.0)
    seconds: float = 1.0

    @property
    def path(self) -> tuple[Array, Array]:
        """Translations (steps, 3), m, and unit quaternions (steps, 4), the rest pose included."""
        count = self.steps // 2 if self.back else self.steps
        part = np.arange(count + 1) / count
        if self.back:
            part = np.concatenate([part, part[-2::-1]])
        return part[:, None] * self.amplitude * np.array(self.along), from_vector(part[:, None] * np.array(self.twist))


@dataclass(frozen=True)
class Hidden:
    """A hidden effect before its term is known.

    Attributes:
        effect: its name.
        target: size it shall have: RMS of the fiducials' shift, in units of noise.
        weights: what a term of one is made of, in units of each parameter's scale, by amount.
        shapes: parameters that say where, in which direction and how fast, SI.
        place: where it acts.
    """

    effect: str
    target: float
    weights: Mapping[str, float] = field(default_factory=dict)
    shapes: Mapping[str, float] = field(default_factory=dict)
    place: str = ""

    @property
    def outside(self) -> bool:
        """Whether it is outside the catalogue."""
        return self.effect in OUTSIDE


@dataclass(frozen=True)
class Case:
    """One case of the study; `noise` in m. `attempt` counts how often it was drawn anew because it could not be solved.

    `inexact` is what its scene states wrongly, if anything, and `felt` what the gripper feels, if it does.
    """

    seed: int
    index: int
    attempt: int
    body: StudyBody
    conditions: Conditions
    kind: str
    anchors: tuple[str, ...]
    motions: tuple[Motion, ...]
    noise: float
    hidden: tuple[Hidden, ...]
    inexact: Inexact | None = None
    felt: Felt | None = None

    @property
    def quietest(self) -> float:
        """The smallest noise that it may have, m."""
        return self.body.noises(self.conditions.nuisances)[0]

    @property
    def made(self) -> list[Action]:
        """The motions as the gripper really makes them."""
        return self.inexact.actions(self.actions) if self.inexact else self.actions

    @property
    def actions(self) -> list[Action]:
        """The commanded motions, on a clock that runs on from action to action."""
        result, start = [], 0.0
        for action, motion in zip(actions([m.path for m in self.motions], ""), self.motions, strict=True):
            times = start + motion.seconds * np.arange(len(action))
            result.append(replace(action, grasp=motion.grasp, times=times))
            start = float(times[-1]) + PAUSE
        return result

    def to_json(self) -> dict[str, Any]:
        """As plain numbers and words."""
        return {name: value for name, value in asdict(self).items() if name != "body"}
