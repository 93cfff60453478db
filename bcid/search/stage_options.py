"""How anchor sets are climbed to in stages, as Boonvisut & Cavusoglu (2014) have it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from bcid.base.errors import InputError, nearest
from bcid.scene import Scene
from bcid.search.termination import Stop, Termination

GROUP = 4
"""Seeds that are climbed from before it is asked whether these are enough."""
_STARTS = ("maxima", "threshold")


@dataclass(frozen=True)
class StageOptions:
    """How the search in stages is done.

    Attributes:
        seeds: random seeds of the first stage.
        random_state: of the seeds; the same number gives the same search.
        coarsest, climbed: first level, and how many levels are climbed on; on finer ones only the likely sets are looked at.
        finest: last level that may be used; with `stop` "settled", the level that is used.
        stop: when the stages end, as `Stop.parse("refinement 0.5 mm")`.
        start: what seeds the second and later stages: "maxima", or "threshold" for every state above `threshold`.
        threshold: similarity, a fraction of the best on the level.
        toggles: random toggles that perturb the seeds of later stages.
        termination: when enough seeds have been climbed from.
    """

    seeds: int = 24
    random_state: int = 0
    coarsest: int = 0
    climbed: int = 2
    finest: int | None = None
    start: str = "maxima"
    threshold: float = 0.95
    toggles: int = 0
    stop: Stop = field(default_factory=Stop)
    termination: Termination = field(default_factory=Termination)

    def last(self, scene: Scene) -> int:
        """The last level that may be used."""
        return len(scene.levels) - 1 if self.finest is None else self.finest

    def check(self, scene: Scene) -> None:
        """Raise `InputError` for options that the scene cannot serve."""
        levels = len(scene.levels)
        if self.start not in _STARTS:
            raise InputError(f"start '{self.start}': {nearest(self.start, _STARTS)}")
        self.stop.check()
        rules = self.termination
        for name, number, least in (
            ("seeds", self.seeds, 1),
            ("random_state", self.random_state, 0),
            ("climbed", self.climbed, 1),
            ("toggles", self.toggles, 0),
            ("patience", rules.patience, 1),
            ("budget", rules.budget, 1),
            ("fit", rules.fit, 0),
            ("threshold", self.threshold, 0),
        ):
            if not (number >= least and math.isfinite(number)):
                raise InputError(f"{name} = {number}: must be at least {least}")
        if self.threshold >= 1:
            raise InputError(f"threshold = {self.threshold}: a part of the best similarity, so it must be below 1")
        for name, level in (("coarsest", self.coarsest), ("finest", self.finest)):
            if level is not None and not 0 <= level < levels:
                raise InputError(f"{name} level {level}: the scene has levels 0 to {levels - 1}")
        if self.finest is not None and self.finest < self.coarsest:
            raise InputError(f"finest level {self.finest} is coarser than the coarsest level {self.coarsest}")
