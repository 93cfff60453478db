"""What the scene may have slightly wrong does to a pull."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.forms.forward import Forward
from bcid.forms.probes import Sensitivities, SensitivityRequest
from bcid.forms.sensitivity import Sensitivity
from bcid.inference.knots import knots_of, known_frames
from bcid.inference.nuisances import Nuisances
from bcid.measurement import Action
from bcid.predict.there_and_back import back, there

Array = NDArray[np.float64]
Anchored = frozenset[str]


@dataclass(frozen=True)
class PullTangent:
    """Sensitivities of a set in a pull, and what was asked for; frames as in the pull."""

    found: Sensitivities
    wanted: SensitivityRequest


class Differentiator:
    """Differentiates pulls on one level. Local to the process.

    Args:
        forward: of the level, whose mesh is not shared.
    """

    def __init__(self, forward: Forward) -> None:
        self.forward, self.nuisances = (
            forward,
            Nuisances(forward.scene, forward.mesh, forward.gripper_force is not None),
        )
        self._sensitivity: Sensitivity | None = None

    def of(self, anchors: Anchored, action: Action) -> PullTangent | None:
        """Of a set in a pull; None where it cannot be followed to the end."""
        self._sensitivity = self._sensitivity or Sensitivity(self.forward)
        wanted = self.nuisances.wanted(self.forward.model, anchors)
        if not (wanted.probes or wanted.law or wanted.places):
            return PullTangent(Sensitivities([], {}), wanted)
        first, mirror = there(action, self.forward.model.steady), back(action, self.forward.model.steady)
        prediction = self.forward.predict(anchors, [first], keep=True)
        if prediction.failure or prediction.states is None:
            return None
        states = {frame: prediction.states[int(same)] for frame, same in enumerate(mirror)}
        whole = replace(prediction, positions=prediction.positions[mirror], states=states)
        numbered = replace(action, frames=np.arange(len(action)))
        way = np.arange(len(action)) < len(first)
        known = knots_of(self.forward.model, [first], np.ones(len(first), dtype=bool))
        seen = way.copy() if known is None else known_frames(known, len(action))
        # A gripper that is off is so at the end as well, where it is back at rest.
        way[-1] = seen[-1] = True
        try:
            found = self._sensitivity.of(anchors, [numbered], whole, wanted, None, seen)
        except SolveError:
            return None
        for array, one in product(found.arrays, known or ()):
            one.fill(array)
        return PullTangent(_at(found, np.where(way, np.arange(len(action)), mirror)), wanted)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._sensitivity is not None:
            self._sensitivity.destroy()


def _at(found: Sensitivities, frames: NDArray[np.int64]) -> Sensitivities:
    """The same with its frames chosen anew."""
    return Sensitivities(
        [{name: array[frames] for name, array in one.items()} for one in found.probes],
        {name: array[frames] for name, array in found.law.items()},
        None,
        None if found.forces is None else found.forces[frames],
        None if found.places is None else found.places[frames],
        growths=None if found.growths is None else found.growths[frames],
    )
