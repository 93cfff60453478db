"""What a body holds against what was put into it: a check that no state is found that the motion cannot lead to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.forms.solver.equilibrium import Equilibrium
from bcid.forms.solver.supports import Pose

Array = NDArray[np.float64]
# The trapezoidal rule may miss this part of the work of one step, and this part of the energy; above, the step is halved.
_OF_STEP, _OF_ENERGY = 0.1, 0.01


@dataclass(frozen=True)
class EnergyCheck:
    """Energy of an equilibrium, and the forces from outside that keep it there.

    A large step can end in a state that is stable, and not the one that the motion leads to. What the two differ in is
    energy: of what a body gains between two equilibria, a gripper that moves slowly has provided every part. Its work is
    told by the trapezoidal rule from the forces at both ends. A state of less energy is not suspicious: a body that
    buckles, or snaps through, loses some.

    Attributes:
        energy: strain energy and potential of the effects, J; the same on all ranks.
        forces: of gripper, anchors and dead loads on this rank's own unknowns, N, see `Equilibrium.applied`.
        moved: how far what they act on has moved, m.
        load_factor: fraction of the effects that acted.
    """

    energy: float
    forces: Array
    moved: Array
    load_factor: float

    @classmethod
    def of(cls, equilibrium: Equilibrium, pose: Pose) -> EnergyCheck:
        """Of a state that was just solved for; collective."""
        return cls(equilibrium.energy(), *equilibrium.applied(), pose.load_factor)

    @classmethod
    def at_rest(cls, equilibrium: Equilibrium) -> EnergyCheck | None:
        """Of the undeformed state; None where effects are to be applied first."""
        none = np.zeros(2 * len(equilibrium.internal))
        return None if equilibrium.model.terms else cls(0.0, none, none, 1.0)

    def follows(self, last: EnergyCheck, equilibrium: Equilibrium) -> bool:
        """Whether the gripper can have led from the last state to this one; collective."""
        if self.load_factor != last.load_factor:
            return True
        work = equilibrium.total(0.5 * float((self.forces + last.forces) @ (self.moved - last.moved)))
        gained = self.energy - last.energy
        unsure = _OF_STEP * max(abs(gained), abs(work)) + _OF_ENERGY * max(abs(self.energy), abs(last.energy))
        return gained - work <= unsure + equilibrium.least_energy
