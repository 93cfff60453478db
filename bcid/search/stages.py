"""Algorithm 2 of Boonvisut & Cavusoglu (2014): hill climbing in stages, on mesh after mesh of the hierarchy, and when it ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from bcid.base.errors import InputError, nearest
from bcid.base.units import quantity
from bcid.scene import Scene
from bcid.search.hill_climbing import Candidate, SetMisfits, climb, perturbed, random_seeds, rank

LAST, SAME, SIMILARITY, REFINEMENT = "last", "same", "similarity", "refinement"
RULES = (LAST, SAME, SIMILARITY, REFINEMENT)
_STARTS = ("maxima", "threshold")


@dataclass(frozen=True)
class Stop:
    """When the stages end before the last level; section 3.5 of the paper.

    Attributes:
        rule: "last": not before; "same": two stages in a row end on the same set (3.5.1); "similarity": that of the best set is at
            least `least` (3.5.2); "refinement": what the best set predicts changes by less than `tolerance` on the next level
            (3.5.3).
        least: similarity, a part of 1.
        tolerance: RMS change of a coordinate, m.
    """

    rule: str = SAME
    least: float = 0.0
    tolerance: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Stop:
        """A rule as it is written: "last", "same", "similarity 0.95" or "refinement 0.5 mm".

        Raises:
            InputError: it is none of these.
        """
        rule, _, value = text.strip().partition(" ")
        if rule not in RULES:
            raise InputError(f"stop '{text}': {nearest(rule, RULES)}")
        if rule in (LAST, SAME):
            if value:
                raise InputError(f"stop '{text}': '{rule}' stands alone")
            return cls(rule)
        example = "similarity 0.95" if rule == SIMILARITY else "refinement 0.5 mm"
        try:
            number = float(value) if rule == SIMILARITY else quantity(value, "m")
        except (ValueError, InputError) as error:
            raise InputError(f"stop '{text}': expected as '{example}' ({error})") from None
        made = cls(rule, least=number) if rule == SIMILARITY else cls(rule, tolerance=number)
        made.check()
        return made

    def check(self) -> None:
        """Raise `InputError` for thresholds that make no sense."""
        if self.rule not in RULES:
            raise InputError(f"stop '{self.rule}': {nearest(self.rule, RULES)}")
        if self.rule == SIMILARITY and not 0 < self.least < 1:
            raise InputError(f"stop: a similarity of {self.least:g}: must be above 0 and below 1")
        if self.rule == REFINEMENT and not (math.isfinite(self.tolerance) and self.tolerance > 0):
            raise InputError(f"stop: a change of {self.tolerance * 1e3:g} mm: must be above 0")

    def reached(self, model: SetMisfits, stages: Sequence[SearchStage]) -> str:
        """Why the search ends after these stages, in words; "" where it goes on. Collective."""
        now = stages[-1]
        if self.rule == SAME and len(stages) > 1 and stages[-2].anchors == now.anchors:
            return "the set is that of the level before"
        if self.rule == SIMILARITY and (similarity := model.similarity(now.rms)) >= self.least:
            return f"the similarity is {similarity:.3g}, at least {self.least:g}"
        if self.rule == REFINEMENT and (change := model.change(now.level, now.anchors)) < self.tolerance:
            mm, most = change * 1e3, self.tolerance * 1e3
            return f"the reconstruction changes by {mm:.3g} mm on the next level, by less than {most:g} mm"
        return ""


@dataclass(frozen=True)
class StageOptions:
    """How the stages are climbed.

    Attributes:
        seeds: random sets that the first stage begins with.
        random_state: of these; the same number gives the same search.
        coarsest, finest: first level, and last level that may be used.
        stop: when the stages end, as `Stop.parse("refinement 0.5 mm")`.
        start: what later stages begin with: "maxima", or "threshold" for every set whose similarity is above `threshold`.
        threshold: similarity, a fraction of the best on the level.
        toggles: random toggles that perturb the sets that later stages begin with.
    """

    seeds: int = 24
    random_state: int = 0
    coarsest: int = 0
    finest: int | None = None
    start: str = "maxima"
    threshold: float = 0.95
    toggles: int = 0
    stop: Stop = field(default_factory=Stop)

    def last(self, scene: Scene) -> int:
        """The last level that may be used."""
        return len(scene.levels) - 1 if self.finest is None else self.finest

    def check(self, scene: Scene) -> None:
        """Raise `InputError` for options that the scene cannot serve."""
        levels = len(scene.levels)
        if self.start not in _STARTS:
            raise InputError(f"start '{self.start}': {nearest(self.start, _STARTS)}")
        self.stop.check()
        for name, number, least in (
            ("seeds", self.seeds, 1),
            ("random_state", self.random_state, 0),
            ("toggles", self.toggles, 0),
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


@dataclass(frozen=True)
class SearchStage:
    """What a stage ended on.

    Attributes:
        level: of the mesh hierarchy.
        maxima: sets that climbs ended on, the best first.
        rms: RMS residual of the best, m.
        evaluated: how many sets were asked for.
    """

    level: int
    maxima: tuple[Candidate, ...]
    rms: float
    evaluated: int

    @property
    def anchors(self) -> Candidate:
        """The best set."""
        return self.maxima[0]


def in_stages(
    model: SetMisfits,
    options: StageOptions,
    last: int,
    seeds: Sequence[Candidate] = (),
    say: Callable[[str], None] = lambda _: None,
) -> list[SearchStage]:
    """Climb on the first level, and on each finer one from what the one before found, until a rule ends it; collective.

    Args:
        model: what residuals sets have.
        options: how.
        last: the last level.
        seeds: sets to begin with, instead of random ones.
        say: told what a stage found.

    Returns:
        The stages, the last of which holds the answer; none where the model has no solution for any set of the first level.
    """
    rng = np.random.default_rng(options.random_state)
    following = list(seeds) or random_seeds(model.patches, options.seeds, rng)
    stages: list[SearchStage] = []
    for level in range(options.coarsest, last + 1):
        tops, found = climb(model, level, following, whole=options.start == "threshold")
        if math.isinf(found[tops[0]]):
            say(f"level {level}: the model has no solution for any of {len(found)} sets")
            break
        best, solved = found[tops[0]], tuple(top for top in tops if math.isfinite(found[top]))
        stages.append(SearchStage(level, solved, best, len(found)))
        counts = f"{len(following)} climbs ended on {len(tops)} maxima, {len(found)} sets were evaluated"
        say(f"level {level}: {counts}; residual of the best {best * 1e3:.3g} mm")
        if level < last and (why := options.stop.reached(model, stages)):
            say(f"level {level} is the last: {why}")
            break
        if options.start == "threshold":
            least = options.threshold * model.similarity(best)
            good = [c for c, rms in found.items() if math.isfinite(rms) and model.similarity(rms) >= least]
            tops = sorted(good, key=lambda c, found=found: rank(found, c))  # type: ignore[misc]
        following = perturbed(tops, model.patches, options.toggles, rng)
    return stages
