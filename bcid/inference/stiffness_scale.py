"""In which unit stiffnesses of the law are reported: Pa, or per thickness where that of a sheet is not known."""

from __future__ import annotations

from dataclasses import dataclass

from bcid.base.units import unit_factor
from bcid.scene import Scene

_PER_THICKNESS = "N/mm"


@dataclass(frozen=True)
class StiffnessScale:
    """How a stiffness of a computed sheet or body is reported.

    Attributes:
        factor: number that is reported for one Pa.
        unit: of it.
        times: what a constant is multiplied by, in words, after its name.
    """

    factor: float = 1.0
    unit: str = "Pa"
    times: str = ""

    @classmethod
    def of(cls, scene: Scene) -> StiffnessScale:
        """Forces tell the product of stiffness and thickness alone: where the thickness is unknown, that is reported."""
        if scene.thickness is None or scene.thickness_known:
            return cls()
        return cls(scene.thickness / unit_factor(_PER_THICKNESS, "N/m"), _PER_THICKNESS, " x thickness")

    @property
    def unknown(self) -> str:
        """What is not known by itself, as a sentence for the end of a list of constants; "" where all is."""
        return "; the thickness is unknown, so that the constants themselves are not known" if self.times else ""
