"""When enough seeds have been climbed from on a level, and when no finer level is needed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bcid.base.errors import InputError, nearest
from bcid.base.units import quantity
from bcid.inference.outcome import Outcome
from bcid.search.evaluator import Evaluator

SETTLED, SAME, SIMILARITY, REFINEMENT = "settled", "same", "similarity", "refinement"
RULES = (SETTLED, SAME, SIMILARITY, REFINEMENT)


@dataclass(frozen=True)
class Termination:
    """Three conditions, looked at after every group of seeds; the first that holds ends the stage.

    Attributes:
        fit: the best RMS residual is at most `fit` times the noise: nothing better can be asked for.
        patience: this many seeds in a row led to nothing better than what was known.
        budget: forward trajectories (whole-trajectory equivalents) computed on this level.
    """

    fit: float = 1.05
    patience: int = 12
    budget: float = 10_000.0

    def reached(self, evaluator: Evaluator, level: int, best: Outcome, seeds_since_better: int) -> str | None:
        """The condition that holds, in words, or None."""
        noise = evaluator.misfit.noise
        if noise is not None and best.rms <= self.fit * noise:
            return f"the residual is the noise ({best.rms * 1e3:.3g} mm, noise {noise * 1e3:.3g} mm)"
        if seeds_since_better >= self.patience:
            return f"{seeds_since_better} seeds in a row led to nothing better"
        if evaluator.evaluations().get(level, 0.0) >= self.budget:
            return f"the budget of {self.budget:g} trajectories is used"
        return None


@dataclass(frozen=True)
class Stop:
    """When the stages end before the last level: bcid's own rule, or one of those of Boonvisut & Cavusoglu (2014), section 3.5.

    Attributes:
        rule: "settled": the set is decided with the error of the level counted, and the residual is the noise or no longer changes;
            "same": two stages in a row end on the same set (3.5.1); "similarity": that of the best set is at least `least` (3.5.2);
            "refinement": what the best set predicts changes by less than `tolerance` on the next level (3.5.3).
        least: similarity, a part of 1 (see `Misfit.similarity`).
        tolerance: RMS change of a coordinate, m.
    """

    rule: str = SETTLED
    least: float = 0.0
    tolerance: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Stop:
        """A rule as it is written: "settled", "same", "similarity 0.95" or "refinement 0.5 mm".

        Raises:
            InputError: it is none of these.
        """
        rule, _, value = text.strip().partition(" ")
        if rule not in RULES:
            raise InputError(f"stop '{text}': {nearest(rule, RULES)}")
        if rule in (SETTLED, SAME):
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

    def reached(self, evaluator: Evaluator, best: list[Outcome]) -> str | None:
        """What the paper's rules say after the stages that ended on `best`, in words, or None; collective.

        "settled" is looked at where the belief is known.
        """
        now = best[-1]
        if self.rule == SAME and len(best) > 1 and best[-2].candidate == now.candidate:
            return "the set is that of the level before"
        if self.rule == SIMILARITY and (similarity := evaluator.misfit.similarity(now.rms)) >= self.least:
            return f"the similarity is {similarity:.3g}, at least {self.least:g}"
        if self.rule == REFINEMENT:
            finer = evaluator.evaluate(now.level + 1, {now.candidate: math.inf})[now.candidate]
            if finer.failed:
                return None
            places = [evaluator.positions(level, now.candidate) for level in (now.level, now.level + 1)]
            change = evaluator.misfit.distance(*places)
            if change < self.tolerance:
                mm, most = change * 1e3, self.tolerance * 1e3
                return f"the reconstruction changes by {mm:.3g} mm on the next level, by less than {most:g} mm"
        return None
