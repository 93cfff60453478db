"""The trials of the exploration study: what holds the body, what is hidden, how it is seen, and how pulls are chosen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

ANCHORS = (("1", "2"), ("3", "4"), ("1", "2", "3", "4"))
NOISES = (0.0, 0.3e-3, 1e-3, 3e-3)
GRASPS = (("II",), ("I", "II", "III"))
STRATEGIES = ("information", "entropy", "random", "fixed")
BUDGET = 20.0
# What may be hidden beside the anchors of `BESIDE`, seen with the noise of `SEEN`, m, with all grasps.
HIDDEN = {
    "nothing": (),
    "gravity": ("gravity: weight = 2000 N/m^3",),
    "soft_anchor": ("soft_anchor: stiffness = 500 kPa/m",),
    "fibres": ("fibres: k1 = 5 kPa, angle = 30 deg",),
}
RIVALS = tuple(name for name, hidden in HIDDEN.items() if hidden)
BESIDE, SEEN, EVERY = ("3", "4"), 0.3e-3, GRASPS[-1]
# Patches 3 and 4 are enclosed by 2, 7 and 8: nothing shows whether they are anchored.
ENCLOSED = ("1", "2", "3", "4", "7", "8")
# Noise of the gripper's force, N, about 2 % of the largest, with which the body is stiffer than its scene by this factor.
FELT, STIFFER = 0.02, 1.2
PARTS = ("main", "hidden", "enclosed", "forces")
# One in so many trials is made of these.
_RARER = 10


@dataclass(frozen=True)
class ExplorationTrial:
    """One exploration: what holds the body, how noisy it is seen, what may be used, how pulls are chosen, and its number.

    `felt` is the noise of the gripper's force, N; 0 where none is measured.
    """

    anchors: tuple[str, ...]
    noise: float
    grasps: tuple[str, ...]
    strategy: str
    number: int
    hidden: str = ""
    felt: float = 0.0

    @property
    def effect(self) -> str:
        """Name of the effect that is to be found, or ""."""
        return self.hidden if HIDDEN.get(self.hidden) else ""

    @property
    def name(self) -> str:
        """For its file."""
        noise = f"{self.noise * 1e6:.0f}um"
        hidden = f"_{self.hidden}" if self.hidden else ""
        felt = f"_{self.felt * 1e3:.0f}mN" if self.felt else ""
        return f"{'-'.join(self.anchors)}_{noise}_{len(self.grasps)}_{self.strategy}{hidden}{felt}_{self.number:03d}"


@dataclass(frozen=True)
class ExplorationExtent:
    """How much of the study is made.

    Attributes:
        count: trials of each kind.
        noises: of the main part, m.
        hidden: what is hidden in the second part (see `HIDDEN`).
        enclosed: anchors of the third part; () to leave it out.
        grasps: that may be used in the main part.
        strategies: how pulls are chosen in the main part.
        felt: noise of the gripper's force in the part with forces, N; 0 to leave it out.
    """

    count: int
    noises: tuple[float, ...] = NOISES
    hidden: tuple[str, ...] = tuple(HIDDEN)
    enclosed: tuple[str, ...] = ENCLOSED
    grasps: tuple[tuple[str, ...], ...] = GRASPS
    strategies: tuple[str, ...] = STRATEGIES
    felt: float = FELT

    @classmethod
    def only(cls, count: int, part: str) -> ExplorationExtent:
        """One of `PARTS`; that with forces also as it is without them."""
        if part == "forces":
            return cls(count, NOISES[1:], (), (), GRASPS[:1], STRATEGIES[:1])
        return cls(
            count,
            NOISES if part == "main" else (),
            tuple(HIDDEN) if part == "hidden" else (),
            ENCLOSED if part == "enclosed" else (),
            felt=0.0,
        )


def trials(extent: ExplorationExtent) -> Iterator[ExplorationTrial]:
    """Every trial, those that take longest first; without noise one is enough of a strategy that draws nothing."""
    few = max(1, extent.count // _RARER)
    for hidden, number in product(extent.hidden, range(few)):
        yield ExplorationTrial(BESIDE, SEEN, EVERY, "information", number, hidden)
    for number in range(few) if extent.enclosed else ():
        yield ExplorationTrial(extent.enclosed, SEEN, EVERY, "information", number)
    for noise, anchors, number in product(extent.noises, ANCHORS, range(extent.count)) if extent.felt else ():
        if noise > 0:
            yield ExplorationTrial(anchors, noise, GRASPS[0], STRATEGIES[0], number, felt=extent.felt)
    for strategy, grasps, noise, anchors in product(extent.strategies, extent.grasps, extent.noises, ANCHORS):
        for number in range(extent.count if noise > 0 or strategy == "random" else 1):
            yield ExplorationTrial(anchors, noise, grasps, strategy, number)
