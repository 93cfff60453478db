"""How well a scene knows what it states: where the markers sit, how large the body is, where patches end, how the gripper holds."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

# Where a scene states nothing: lengths as parts of the body's size (the diagonal of its box), forces as parts of the largest that
# was measured, angles in degrees.
_USUAL = {
    "markers": 0.005,
    "dimensions": 0.02,
    "borders": 0.01,
    "grip": 0.005,
    "grip_turn": 0.5,
    "camera": 0.2,
    "scale": 0.0,
    "poisson": 0.03,
    "law": 0.05,
    "stiffness": 0.5,
    "force_gain": 0.01,
    "force_bias": 0.005,
    "force_drift": 0.005,
    "gripper_weight": 0.0,
}
LENGTHS = ("markers", "borders", "grip")
ANGLES = ("grip_turn", "camera")
FORCES = ("force_bias", "force_drift", "gripper_weight")
# What counts only where forces are measured; the first also where loads act.
FORCED = ("stiffness", "force_gain", *FORCES)
# Beyond this a factor of all lengths is not known to first order, and rather a slip of units.
MOST_SCALE = 0.3
# Poisson's ratio is not taken to be closer to a half than this part of its distance, in standard deviations.
_TO_HALF = 1 / 3


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of what a scene states; 0 for what is exact, None where nothing is said.

    Attributes:
        markers: of a fiducial's place on the body along each axis, m.
        dimensions: of the body's extent along each axis, relative.
        borders: of where a patch ends, and in each action where the gripper holds the body, m.
        grip: of the gripper's place against the one reported, the same over an action from its first step on, along each axis, m.
        grip_turn: of its rotation likewise, about each axis, deg.
        camera: of the directions of the measured frame's axes, deg; a measurement that states the error of its frame knows better.
        scale: of the length of a pixel, relative: a factor of all lengths from pictures together, which are the positions that were
            measured, the body, its fiducials and its grasps; a measurement that states it knows better.
        scale_of_gripper: whether the gripper's path was measured in the same pictures, so that it has that factor too; None where
            nothing is said, which is no.
        poisson: of Poisson's ratio.
        law: of its form at large strains: of the coefficient of (I1bar - 3)^2 in its energy, in units of the shear modulus;
            the part of that which goes with the second invariant is four times as uncertain.
        stiffness: of all stiffnesses of the law together, relative, where forces are measured or known loads act. The following
            count where forces are measured.
        force_gain: of the force sensor's gain, relative.
        force_bias: of what it shows without a force, along each axis of the gripper, N; of a torque in proportion.
        force_drift: by how much that changes over an action, N.
        gripper_weight: of the weight of the gripper that it feels besides, N.
    """

    markers: float | None = None
    dimensions: float | None = None
    borders: float | None = None
    grip: float | None = None
    grip_turn: float | None = None
    camera: float | None = None
    scale: float | None = None
    scale_of_gripper: bool | None = None
    poisson: float | None = None
    law: float | None = None
    stiffness: float | None = None
    force_gain: float | None = None
    force_bias: float | None = None
    force_drift: float | None = None
    gripper_weight: float | None = None

    @classmethod
    def none(cls) -> Uncertainty:
        """Everything is exactly as stated."""
        return cls(**dict.fromkeys(NUMBERS, 0.0))  # type: ignore[arg-type]

    def of(self, size: float, poisson: float | None = None, force: float = 0.0) -> Uncertainty:
        """With what is usual for a body of this size (m), Poisson's ratio and largest force (N) where nothing is said."""
        units = dict.fromkeys(LENGTHS, size) | dict.fromkeys(FORCES, force)
        usual = {name: part * units.get(name, 1.0) for name, part in _USUAL.items()}
        if poisson is not None:
            usual["poisson"] = min(usual["poisson"], _TO_HALF * (0.5 - poisson))
        unsaid = {name: value for name, value in usual.items() if getattr(self, name) is None}
        return replace(self, **unsaid)  # type: ignore[arg-type]


# Those that are numbers: all but a statement.
NUMBERS = tuple(field.name for field in fields(Uncertainty) if field.name != "scale_of_gripper")
