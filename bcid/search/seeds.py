"""Where climbs start: at random, at the maxima of a coarser level, or at every good state seen there; perturbed if wanted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from bcid.inference.outcome import Candidate
from bcid.search.climb import Climb, rank
from bcid.search.evaluator import Evaluator


def random_seeds(patches: Sequence[str], count: int, rng: np.random.Generator) -> list[Candidate]:
    """Different random sets, every patch anchored with probability 1/2; all sets, shuffled, when there are no more than `count`."""
    if 2 ** len(patches) <= count:
        everything = [_decode(code, patches) for code in range(2 ** len(patches))]
        return [everything[i] for i in rng.permutation(len(everything))]
    seeds: dict[Candidate, None] = {}
    while len(seeds) < count:
        seeds[frozenset(p for p, on in zip(patches, rng.random(len(patches)) < 0.5, strict=True) if on)] = None
    return list(seeds)


def all_candidates(patches: Sequence[str]) -> list[Candidate]:
    """Every set of patches."""
    return [_decode(code, patches) for code in range(2 ** len(patches))]


def _decode(code: int, patches: Sequence[str]) -> Candidate:
    return frozenset(patch for i, patch in enumerate(patches) if code >> i & 1)


def maxima(climbs: Iterable[Climb], evaluator: Evaluator, level: int) -> list[Candidate]:
    """The local maxima that climbs ended on, best first."""
    tops = dict.fromkeys(climb.top for climb in climbs)
    return sorted(tops, key=lambda candidate: rank(evaluator.outcomes[level, candidate]))


def above(evaluator: Evaluator, level: int, similarity: float) -> list[Candidate]:
    """Every state visited on a level whose similarity exceeds a threshold, best first."""
    found = [o for (at, _), o in evaluator.outcomes.items() if at == level and o.complete]
    good = [o for o in found if evaluator.misfit.similarity(o.rms) > similarity]
    return [o.candidate for o in sorted(good, key=rank)]


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
