"""What of a scene's law a term takes away that acts in its place, per unit of the shear modulus.

Of a law whose distortion and change of volume store energy apart that is (I1bar - 3)/2. A compressible neo-Hookean law
(Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, 2nd ed. (2008), chapter 6) couples both:
(I1 - 3)/2 - ln J. Were the first taken from the second, the coupling, which grows with the strain, would be left of a law
that does not act any more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import ufl
from numpy.typing import NDArray

from bcid.forms.kinematics import Kinematics
from bcid.forms.model import Model
from bcid.grammar.deformed import Deformed

Array = NDArray[np.float64]
# Axes of the plane of fibres, a deformation, and how nearly two energies are one there.
_AXES, _SEEN, _SAME = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), ((1.3, 0.1, 0.0), (0.0, 0.9, 0.2), (0.1, 0.0, 1.1)), 1e-9


@dataclass(frozen=True)
class ReplacedLaw:
    """The part of a law that a term takes the place of; its bulk modulus at small strain is zero.

    Attributes:
        coupled: whether change of volume and distortion store energy together.
        code: the energy, in UFL.
        text: as it is written in a formula.
        slope: its derivative by F, at points, shape (q, 3, 3).
    """

    coupled: bool
    code: str
    text: str
    slope: Callable[[Deformed], Array]

    @classmethod
    def of(cls, model: Model) -> ReplacedLaw:
        """That of the law of a model."""
        constants = model.law.complete(model.values)
        kin = Kinematics.from_gradient(ufl.as_matrix([list(row) for row in _SEEN]), _AXES)
        stored = float(model.law.energy(kin, constants)) / float(model.law.shear(constants))
        neo_hookean = float(kin.I1_minus_3 / 2 - kin.lnJ)
        return COUPLED if abs(stored - neo_hookean) < _SAME else APART


def _coupled_slope(d: Deformed) -> Array:
    by = 1 + 2 / 3 * np.log(d.J)
    return np.asarray(d.F - by[:, None, None] * d.inverse_transposed)


APART = ReplacedLaw(False, "point.kin.I1bar_minus_3 / 2", "(I1bar - 3)/2", lambda d: d.first_slope / 2)
COUPLED = ReplacedLaw(
    True,
    "(point.kin.I1_minus_3 / 2 - point.kin.lnJ - point.kin.lnJ**2 / 3)",
    "((I1 - 3)/2 - ln J - (ln J)^2/3)",
    _coupled_slope,
)
