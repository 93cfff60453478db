"""How well a scene knows what it states: where the markers sit, how large the body is, where patches end, how the gripper holds."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

# Where a scene states nothing: lengths as parts of the body's size (the diagonal of its box), angles in degrees.
_USUAL = {
    "markers": 0.005,
    "dimensions": 0.02,
    "borders": 0.01,
    "grip": 0.005,
    "grip_turn": 0.5,
    "camera": 0.2,
    "poisson": 0.03,
    "law": 0.05,
}
LENGTHS = ("markers", "borders", "grip")
ANGLES = ("grip_turn", "camera")
# Poisson's ratio is not taken to be closer to a half than this part of its distance, in standard deviations.
_TO_HALF = 1 / 3


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of what a scene states; 0 for what is exact, None where nothing is said.

    Attributes:
        markers: of a fiducial's place on the body along each axis, m.
        dimensions: of the body's extent along each axis, relative.
        borders: of where a patch ends, m.
        grip: of the gripper's place against the one reported, the same over an action from its first step on, along each axis, m.
        grip_turn: of its rotation likewise, about each axis, deg.
        camera: of the directions of the measured frame's axes, deg; a measurement that states the error of its frame knows better.
        poisson: of Poisson's ratio.
        law: of its form at large strains: of the coefficient of (I1bar - 3)^2 in its energy, in units of the shear modulus.
    """

    markers: float | None = None
    dimensions: float | None = None
    borders: float | None = None
    grip: float | None = None
    grip_turn: float | None = None
    camera: float | None = None
    poisson: float | None = None
    law: float | None = None

    @classmethod
    def none(cls) -> Uncertainty:
        """Everything is exactly as stated."""
        return cls(**{field.name: 0.0 for field in fields(cls)})

    def of(self, size: float, poisson: float | None = None) -> Uncertainty:
        """With what is usual for a body of this size (m) and Poisson's ratio where nothing is said."""
        usual = {name: part * (size if name in LENGTHS else 1.0) for name, part in _USUAL.items()}
        if poisson is not None:
            usual["poisson"] = min(usual["poisson"], _TO_HALF * (0.5 - poisson))
        return replace(self, **{name: value for name, value in usual.items() if getattr(self, name) is None})
