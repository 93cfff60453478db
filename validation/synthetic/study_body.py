"""A body of the hidden study: how it may be held and pulled, and where in it something can be hidden."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bcid.scene import Level

Vector = tuple[float, float, float]
Range = tuple[float, float]
Sets = tuple[tuple[str, ...], ...]

CATALOGUE = (
    "gravity", "strain_stiffening", "compressibility", "fibres", "stiffness_gradient", "inclusion", "prestrain",
    "active_stress", "viscosity", "soft_anchor", "foundation", "support_contact", "support_friction", "grasp_slip",
    "grasp_offset", "camera_offset", "time_lag", "marker_fault", "permanent_set", "swelling",
    "obstacle", "release", "tether",
)  # fmt: skip
# Usual standard deviations of the coordinates, m.
NOISE = (1e-4, 5e-4)
# What only a body that lies on something can have.
_OF_SUPPORT = frozenset({"foundation", "support_contact", "support_friction"})


@dataclass(frozen=True)
class Way:
    """A direction in which a grasp is moved.

    Attributes:
        along: unit vector.
        reach: how far at least and at most, m.
        crowded: the same where an anchored patch lies beside one of the grasps; None where that is no matter.
    """

    along: Vector
    reach: Range
    crowded: Range | None = None


@dataclass(frozen=True)
class Ball:
    """Where a round part may lie: ranges of its centre along x, y and z and of its radius, m."""

    x: Range
    y: Range
    z: Range
    radius: Range


@dataclass(frozen=True)
class Obstacle:
    """Where a rigid ball may hang above the body.

    Attributes:
        x: range of its centre, m.
        beside: how far its z may lie from that of the lifted grasp, m.
        top: height (y) of the body below it, m.
        radius: range, m; a large ball is nearly a plane.
    """

    x: Range
    beside: float
    top: float
    radius: Range


@dataclass(frozen=True)
class StudyBody:
    """A body that cases are made of; y points up.

    Attributes:
        name: as `--bodies` has it.
        scene: the shipped scene file.
        sound: sets of patches that hold it soundly and of which each patch matters.
        grasps: their middles, m, by name.
        beside: by grasp the patches so near that the tissue between would be crushed: where one is anchored, it is not used.
        ways: directions by name.
        pull, lift: names of the ways that every case has.
        across: names of ways of which every case has one.
        noise: range of standard deviations of the coordinates, m, where the scene is exact.
        axis: unit vector of the axis of twists.
        twist: range of their angles, degrees.
        fiducials: how many the scene has; they are numbered from 1.
        plane: axes along which a change of stiffness or a stretch can be seen.
        ball: where an inclusion may lie.
        obstacle: where a ball may hang above it.
        supported: whether it lies on something.
        true: elements of the truth.
        coarse: elements for finding the size of a term.
    """

    name: str
    scene: str
    sound: Sets
    grasps: Mapping[str, Vector]
    ways: Mapping[str, Way]
    pull: str
    across: tuple[str, ...]
    lift: str
    axis: Vector
    fiducials: int
    ball: Ball
    obstacle: Obstacle
    true: Level
    coarse: Level
    noise: Range = NOISE
    twist: Range = (10.0, 30.0)
    plane: tuple[str, ...] = ("x", "z")
    supported: bool = True
    beside: Mapping[str, frozenset[str]] = field(default_factory=dict)

    @property
    def catalogue(self) -> tuple[str, ...]:
        """The effects that it can have."""
        return tuple(name for name in CATALOGUE if self.supported or name not in _OF_SUPPORT)

    def noises(self, nuisances: bool) -> Range:
        """Range of the noise, m: to look closely does not help where much else is wrong."""
        return NOISE if nuisances else self.noise

    def sets(self, peeled: bool = False) -> Sets:
        """The sound sets; with `peeled` those that hold the body without any one of their patches too."""
        if not peeled:
            return self.sound
        known = {frozenset(s) for s in self.sound}
        return tuple(s for s in self.sound if len(s) > 1 and all(frozenset(s) - {patch} in known for patch in s))
