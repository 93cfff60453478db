"""Algorithm 1 of Boonvisut & Cavusoglu (2014): hill climbing over single toggles of patches, from random sets of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

import numpy as np

Candidate = frozenset[str]


class SetMisfits(Protocol):
    """What the search asks of a model. Collective where the model is."""

    @property
    def patches(self) -> list[str]:
        """Names of the candidate patches, in the scene's order."""
        ...

    def misfits(self, level: int, bounds: Mapping[Candidate, float]) -> dict[Candidate, float]:
        """RMS residuals of sets on a mesh level, m.

        Infinite where the model has no solution, and where the residual is known to be above the bound that a set has.
        """
        ...

    def similarity(self, rms: float) -> float:
        """1 for a residual of nothing, 0 for one as large as the motion."""
        ...

    def change(self, level: int, candidate: Candidate) -> float:
        """RMS difference of what a set predicts on a level and on the next finer one, m."""
        ...


def rank(misfits: Mapping[Candidate, float], candidate: Candidate) -> tuple[float, int, list[str]]:
    """Sorting key: the best set first; ties go to fewer patches, then to the first in order of names."""
    return misfits[candidate], len(candidate), sorted(candidate)


def neighbours(candidate: Candidate, patches: Sequence[str]) -> list[Candidate]:
    """All sets that differ by one patch, in the order of the patches."""
    return [candidate ^ {patch} for patch in patches]


def climb(
    model: SetMisfits, level: int, seeds: Iterable[Candidate], whole: bool = False
) -> tuple[list[Candidate], dict[Candidate, float]]:
    """Climb from every seed, each to its best neighbour until none is better; collective.

    Where a climb goes depends only on which sets are better than the one it is at: the evaluation of a neighbour ends as soon as it
    is worse, unless `whole` residuals are asked for. The neighbours of all climbers are one batch.

    Returns:
        The different sets that climbs ended on, the best first, and the residuals of all sets that were asked for, m.
    """
    here = list(dict.fromkeys(seeds))
    found = dict(model.misfits(level, dict.fromkeys(here, math.inf)))
    active, tops = here, list[Candidate]()
    while active:
        bounds: dict[Candidate, float] = {}
        for one in active:
            for other in neighbours(one, model.patches):
                bounds[other] = math.inf if whole else max(bounds.get(other, 0.0), found[one])
        found |= {c: found.get(c, math.inf) if math.isinf(m) else m for c, m in model.misfits(level, bounds).items()}
        moved = list[Candidate]()
        for one in active:
            best = min(neighbours(one, model.patches), key=lambda c: rank(found, c))
            better = rank(found, best) < rank(found, one)
            (moved if better else tops).append(best if better else one)
        active = list(dict.fromkeys(moved))
    return sorted(dict.fromkeys(tops), key=lambda c: rank(found, c)), found


def random_seeds(patches: Sequence[str], count: int, rng: np.random.Generator) -> list[Candidate]:
    """Different random sets, every patch anchored with probability 1/2; all sets, shuffled, when there are no more than `count`."""
    if 2 ** len(patches) <= count:
        everything = all_candidates(patches)
        return [everything[i] for i in rng.permutation(len(everything))]
    seeds: dict[Candidate, None] = {}
    while len(seeds) < count:
        seeds[frozenset(p for p, on in zip(patches, rng.random(len(patches)) < 0.5, strict=True) if on)] = None
    return list(seeds)


def perturbed(
    seeds: Iterable[Candidate], patches: Sequence[str], toggles: int, rng: np.random.Generator
) -> list[Candidate]:
    """The seeds, each followed by a copy with `toggles` random patches toggled; duplicates dropped."""
    result: dict[Candidate, None] = {}
    for seed in seeds:
        result[seed] = None
        if toggles:
            chosen = rng.choice(len(patches), size=min(toggles, len(patches)), replace=False)
            result[seed ^ {patches[i] for i in chosen}] = None
    return list(result)


def all_candidates(patches: Sequence[str]) -> list[Candidate]:
    """Every set of patches."""
    codes = range(2 ** len(patches))
    return [frozenset(patch for i, patch in enumerate(patches) if code >> i & 1) for code in codes]
