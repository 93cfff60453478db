"""Algorithm 1 of Boonvisut & Cavusoglu (2014) as it stands there, on misfits that are known: hill climbing over single toggles.

Every distinct set on a level counts as one call of the model, computed in full. `bcid.search` does the same with fewer and
shorter calls; here what counts is what the paper's search finds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

Candidate = frozenset[str]
# The misfit of a set on a level; infinite where the model has no solution.
Misfit = Callable[[int, Candidate], float]


@dataclass(frozen=True)
class SearchResult:
    """What a search ended on, and how many sets it looked at on each level."""

    anchors: Candidate
    calls: Mapping[int, int]


class _Counted:
    """Misfits, with a note of every set that was asked for."""

    def __init__(self, misfit: Misfit) -> None:
        self.misfit = misfit
        self.seen: dict[int, set[Candidate]] = {}

    def key(self, level: int, candidate: Candidate) -> tuple[float, int, list[str]]:
        """Sorting key: the best first; ties go to fewer patches, then to the first in order of names."""
        self.seen.setdefault(level, set()).add(candidate)
        return self.misfit(level, candidate), len(candidate), sorted(candidate)

    def climb(self, level: int, seed: Candidate, patches: Sequence[str]) -> Candidate:
        """To the best neighbour until none is better."""
        here = seed
        while True:
            best = min((here ^ {patch} for patch in patches), key=lambda c: self.key(level, c))
            if not self.key(level, best) < self.key(level, here):
                return here
            here = best

    def found(self, anchors: Candidate) -> SearchResult:
        return SearchResult(anchors, {level: len(sets) for level, sets in sorted(self.seen.items())})


def in_stages(misfit: Misfit, patches: Sequence[str], seeds: Iterable[Candidate], last: int) -> SearchResult:
    """From the seeds on level 0, from the maxima found there on level 1, and the best of those once on each finer level."""
    counted = _Counted(misfit)
    following = list(dict.fromkeys(seeds))
    for level in range(min(2, last + 1)):
        tops = dict.fromkeys(counted.climb(level, seed, patches) for seed in following)
        following = sorted(tops, key=lambda c, level=level: counted.key(level, c))  # type: ignore[misc]
    for level in range(2, last + 1):
        counted.key(level, following[0])
    return counted.found(following[0])


def in_one_stage(misfit: Misfit, patches: Sequence[str], seeds: Iterable[Candidate], level: int) -> SearchResult:
    """From the seeds on one level alone."""
    counted = _Counted(misfit)
    tops = {counted.climb(level, seed, patches) for seed in dict.fromkeys(seeds)}
    return counted.found(min(tops, key=lambda c: counted.key(level, c)))


def optimum(misfit: Misfit, sets: Iterable[Candidate], level: int) -> Candidate:
    """The best of all sets on a level: what no search can do better than."""
    counted = _Counted(misfit)
    return min(sets, key=lambda c: counted.key(level, c))
