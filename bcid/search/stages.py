"""Algorithm 2 of Boonvisut & Cavusoglu (2014): hill climbing in stages, on mesh after mesh of the hierarchy, and when it ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bcid.base.options import REFINEMENT, SAME, SIMILARITY, StageOptions, Stop
from bcid.search.hill_climbing import Candidate, SetMisfits, climb, perturbed, random_seeds, rank


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


def why_last(stop: Stop, model: SetMisfits, stages: Sequence[SearchStage]) -> str:
    """Why the search ends after these stages, in words; "" where it goes on. Collective."""
    now = stages[-1]
    if stop.rule == SAME and len(stages) > 1 and stages[-2].anchors == now.anchors:
        return "the set is that of the level before"
    if stop.rule == SIMILARITY and (similarity := model.similarity(now.rms)) >= stop.least:
        return f"the similarity is {similarity:.3g}, at least {stop.least:g}"
    if stop.rule == REFINEMENT and (change := model.change(now.level, now.anchors)) < stop.tolerance:
        mm, most = change * 1e3, stop.tolerance * 1e3
        return f"the reconstruction changes by {mm:.3g} mm on the next level, by less than {most:g} mm"
    return ""


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
    rng = np.random.default_rng(options.seed)
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
        if level < last and (why := why_last(options.stop, model, stages)):
            say(f"level {level} is the last: {why}")
            break
        if options.start == "threshold":
            least = options.threshold * model.similarity(best)
            good = [c for c, rms in found.items() if math.isfinite(rms) and model.similarity(rms) >= least]
            tops = sorted(good, key=partial(rank, found))
        following = perturbed(tops, model.patches, options.perturb, rng)
    return stages
