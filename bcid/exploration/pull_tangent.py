"""What small changes do to a pull: where the scene may be slightly wrong, and what an unknown force would move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.exploration.motion import back, there
from bcid.forms.force_bumps import BUMPS, bumps, growth_bumps
from bcid.forms.forward import Forward
from bcid.forms.model import Model
from bcid.forms.probes import Sensitivities, SensitivityRequest
from bcid.forms.sensitivity import Sensitivity
from bcid.inference.data import Data
from bcid.inference.discrepancy import SmoothDiscrepancy
from bcid.inference.knots import knots_of, known_frames
from bcid.inference.nuisances import NuisanceModes, Nuisances
from bcid.measurement import Action

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
        self._bumps: tuple[Array, Array] | None = None

    def of(self, anchors: Anchored, action: Action, forces: bool) -> PullTangent | None:
        """Of a set in a pull, with or without those to an unknown force; None where it cannot be followed to the end."""
        if self._sensitivity is None:
            self._sensitivity = Sensitivity(self.forward)
            self._bumps = bumps(self.forward, BUMPS)[1], growth_bumps(self.forward)
        wanted = self.nuisances.wanted(self.forward.model, anchors)
        wanted = replace(wanted, forces=self._bumps[0], growths=self._bumps[1]) if forces and self._bumps else wanted
        if not (wanted.probes or wanted.law or wanted.places or forces):
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


def _together(parts: Sequence[Sensitivities]) -> Sensitivities:
    """Sensitivities of one set in several pulls as those in one measurement."""
    first = parts[0]
    names = [list(one) for one in first.probes]
    whole = [{n: np.concatenate([p.probes[i][n] for p in parts]) for n in own} for i, own in enumerate(names)]
    law = {name: np.concatenate([p.law[name] for p in parts]) for name in first.law}
    forces = [p.forces for p in parts if p.forces is not None]
    places = [p.places for p in parts if p.places is not None]
    growths = [p.growths for p in parts if p.growths is not None]
    return Sensitivities(
        whole,
        law,
        forces=np.concatenate(forces) if forces else None,
        places=np.concatenate(places) if places else None,
        growths=np.concatenate(growths) if growths else None,
    )


def modes(
    nuisances: Nuisances, data: Data, tangents: Sequence[PullTangent], model: Model, predicted: Array
) -> NuisanceModes:
    """What nuisances do to the values of pulls, of each of which the tangent is given, in the order of their frames.

    `predicted` are the values that the model predicts, (frames, rows, 3), m.
    """
    return nuisances.modes(data, _together([t.found for t in tangents]), tangents[0].wanted, model, predicted)


def unknown(data: Data, tangents: Sequence[PullTangent], unit: float) -> SmoothDiscrepancy:
    """What something unknown and smooth does to the values of pulls."""
    found = _together([t.found for t in tangents])
    if found.forces is None:
        return SmoothDiscrepancy.nothing(len(data))
    return SmoothDiscrepancy.of(data, found.forces, found.growths, unit)


def nothing(shape: tuple[int, ...], like: PullTangent) -> PullTangent:
    """A tangent of a pull of which nothing is known: values (frames, rows, 3) that nothing moves."""

    def zeros(array: Mapping[str, Array]) -> dict[str, Array]:
        return {name: np.zeros(shape) for name in array}

    forces, places, growths = like.found.forces, like.found.places, like.found.growths
    return PullTangent(
        Sensitivities(
            [zeros(one) for one in like.found.probes],
            zeros(like.found.law),
            None,
            None if forces is None else np.zeros((*shape, *forces.shape[3:]), np.float32),
            None if places is None else np.zeros((*shape, 3)),
            growths=None if growths is None else np.zeros((*shape, growths.shape[-1]), np.float32),
        ),
        like.wanted,
    )
