"""Under which conditions a case is diagnosed: what its scene says of the noise, how exact it is, and how fine its meshes are."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

# What the scene says of the noise.
RIGHT, UNSTATED = "right", "unstated"
_FACTORS = {RIGHT: 1.0, "half": 0.5, "double": 2.0}
FINE, COARSE = "fine", "coarse"
# Elements of the coarse ladder are so many times as large.
COARSER = 1.4


@dataclass(frozen=True)
class Conditions:
    """Of one case.

    Attributes:
        noise: what is stated: "right", "unstated", "half" or "double".
        nuisances: whether everything else that the scene states is slightly wrong (see `validation.synthetic.inexact`).
        mesh: of the diagnosis, "fine" or "coarse".
        forces: whether the gripper feels forces; the body is then not as stiff as its scene says (see `validation.synthetic.felt`).
    """

    noise: str = RIGHT
    nuisances: bool = False
    mesh: str = FINE
    forces: bool = False

    def stated(self, noise: float) -> float | None:
        """What the scene says of a noise (m); None for nothing."""
        return noise * _FACTORS[self.noise] if self.noise in _FACTORS else None


# By the name of `--conditions`; those of a list take turns. The noise is as often wrong, by either factor, as right.
CONDITIONS = {
    "exact": (Conditions(),),
    "inexact": (Conditions(nuisances=True),),
    "forces": (Conditions(forces=True), Conditions(nuisances=True, forces=True)),
    "all": tuple(
        Conditions(*each)
        for each in product((RIGHT, RIGHT, UNSTATED, UNSTATED, "half", "double"), (False, True), (FINE, COARSE))
    ),
}
