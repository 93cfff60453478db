"""Algorithm 1 of Boonvisut & Cavusoglu (2014) and its stages as they stand there: hill climbing, on mesh after mesh.

Every distinct set on a level counts as one call of the model, computed in full. `bcid.search` does the same with fewer and
shorter calls; here what counts is what the paper's search finds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Candidate = frozenset[str]
# When the stages end, with the section of the paper: at the last level; when two stages end on the same set (3.5.1); when the
# similarity of the best set is above a threshold (3.5.2); when its reconstruction changes little on the finer mesh (3.5.3).
STOPS = ("last", "same", "similarity", "refinement")


class MisfitModel(Protocol):
    """What the search asks."""

    def misfit(self, level: int, candidate: Candidate) -> float:
        """RMS residual of a set on a level, m; infinite where the model has no solution."""
        ...

    def change(self, level: int, candidate: Candidate) -> float:
        """RMS difference, m, of what a set predicts on a level and on the next finer one."""
        ...


@dataclass(frozen=True)
class Rule:
    """When the stages end.

    Attributes:
        stop: one of `STOPS`.
        tolerance: for "similarity", the RMS residual, and for "refinement", the RMS change of the reconstruction, that ends them
            when it is below this, m.
        last: no finer level is climbed on.
    """

    stop: str
    tolerance: float
    last: int


@dataclass(frozen=True)
class SearchStage:
    """What a stage ended on: its level, the best set, the RMS residual of that, m."""

    level: int
    anchors: Candidate
    rms: float


@dataclass(frozen=True)
class SearchResult:
    """The stages of a search, the last of which holds the answer, and how many sets were looked at on each level."""

    stages: tuple[SearchStage, ...]
    calls: dict[int, int]

    @property
    def anchors(self) -> Candidate:
        """The answer."""
        return self.stages[-1].anchors


class _Counted:
    """A model, with a note of every set that was asked for."""

    def __init__(self, model: MisfitModel) -> None:
        self.model = model
        self.seen: dict[int, set[Candidate]] = {}

    def misfit(self, level: int, candidate: Candidate) -> float:
        self.seen.setdefault(level, set()).add(candidate)
        return self.model.misfit(level, candidate)

    def key(self, level: int, candidate: Candidate) -> tuple[float, int, list[str]]:
        """Sorting key: the best first; ties go to fewer patches, then to the first in order of names."""
        return self.misfit(level, candidate), len(candidate), sorted(candidate)

    def climb(self, level: int, seed: Candidate, patches: Sequence[str]) -> Candidate:
        """To the best neighbour until none is better."""
        here = seed
        while True:
            best = min((here ^ {patch} for patch in patches), key=lambda c: self.key(level, c))
            if not self.key(level, best) < self.key(level, here):
                return here
            here = best

    def ends(self, stages: Sequence[SearchStage], rule: Rule) -> bool:
        """Whether the rule ends the search after these stages."""
        now = stages[-1]
        if now.level >= rule.last:
            return True
        if rule.stop == "same":
            return len(stages) > 1 and stages[-2].anchors == now.anchors
        if rule.stop == "similarity":
            return now.rms < rule.tolerance
        if rule.stop == "refinement":
            self.misfit(now.level + 1, now.anchors)
            return self.model.change(now.level, now.anchors) < rule.tolerance
        return False


def in_stages(
    model: MisfitModel, patches: Sequence[str], seeds: Iterable[Candidate], rule: Rule, first: int = 0
) -> SearchResult:
    """Climb from the seeds on the first level, and on each finer one from the maxima of the one before, until the rule ends it."""
    counted = _Counted(model)
    following = list(dict.fromkeys(seeds))
    stages: list[SearchStage] = []
    for level in range(first, rule.last + 1):
        tops = dict.fromkeys(counted.climb(level, seed, patches) for seed in following)
        following = sorted(tops, key=lambda c, level=level: counted.key(level, c))  # type: ignore[misc]
        stages.append(SearchStage(level, following[0], counted.misfit(level, following[0])))
        if counted.ends(stages, rule):
            break
    return SearchResult(tuple(stages), {level: len(sets) for level, sets in sorted(counted.seen.items())})


def optimum(model: MisfitModel, sets: Iterable[Candidate], level: int) -> Candidate:
    """The best of all sets on a level: what no search can do better than."""
    counted = _Counted(model)
    return min(sets, key=lambda c: counted.key(level, c))
