"""Algorithm 1 of Boonvisut & Cavusoglu (2014): hill climbing over single toggles of patches."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bcid.inference.outcome import Candidate, Outcome
from bcid.search.evaluator import Evaluator
from bcid.search.screening import rejection_bound
from bcid.search.settings import SETTINGS


@dataclass(frozen=True)
class Climb:
    """One climb: where it started, its path, and the local maximum of similarity where it ended."""

    path: tuple[Candidate, ...]

    @property
    def seed(self) -> Candidate:
        """Where it started."""
        return self.path[0]

    @property
    def top(self) -> Candidate:
        """Where no single toggle helps any more."""
        return self.path[-1]


def neighbours(candidate: Candidate, patches: Sequence[str]) -> list[Candidate]:
    """All sets that differ by one patch, in the order of the patches."""
    return [candidate ^ {patch} for patch in patches]


def better(a: Outcome, b: Outcome) -> bool:
    """Whether a explains the measurement better than b; ties go to fewer patches, then to the first in order of names."""
    return rank(a) < rank(b)


def rank(outcome: Outcome) -> tuple[float, int, list[str]]:
    """Sorting key: the best outcome first."""
    return outcome.chi2, len(outcome.candidate), sorted(outcome.candidate)


def climb(evaluator: Evaluator, level: int, seeds: Iterable[Candidate]) -> list[Climb]:
    """Climb from every seed at once, each to its best neighbour until none is better; collective.

    The neighbours of all climbers are one batch for the evaluator. A neighbour that is `SearchSettings.odds` times less likely
    than its parent stops early: it cannot be where the climber goes.
    """
    paths = [[seed] for seed in dict.fromkeys(seeds)]
    evaluator.evaluate(level, {path[0]: float("inf") for path in paths})
    active = list(range(len(paths)))
    while active:
        bounds: dict[Candidate, float] = {}
        for i in active:
            here = evaluator.outcomes[level, paths[i][-1]]
            for candidate in neighbours(here.candidate, evaluator.patches):
                bounds[candidate] = max(
                    bounds.get(candidate, 0.0), rejection_bound(here, evaluator.misfit, SETTINGS.odds)
                )
        found = evaluator.evaluate(level, bounds)
        moved = []
        for i in active:
            here = evaluator.outcomes[level, paths[i][-1]]
            best = min((found[c] for c in neighbours(here.candidate, evaluator.patches)), key=rank)
            if better(best, here) and best.complete:
                paths[i].append(best.candidate)
                moved.append(i)
        active = moved
    return [Climb(tuple(path)) for path in paths]
